"""What a node's code depends on that no text of modules can tell: the environment, files, computed code and imports.

It is told, and not keyed: by `why`, `plan` and `doctor`. A line is left out that ends in `# not in the key: reason`,
or has such a comment above it.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import gc
import importlib.metadata
import inspect
import re
import sys
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph import pythontree
from exmesh_graph.api.kept import is_changed
from exmesh_graph.api.reach import looked_at, unseen_in
from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import sha256_file
from exmesh_graph.graph.cache.fingerprint import Sources
from exmesh_graph.graph.cache.moduletext import OWN, ModuleText, is_ignored
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current


def unseen(definitions: Iterable[NodeDef]) -> list[str]:
    """`module:line: words` of every place in the code of nodes and components; what cannot be read is left out."""
    told: dict[str, None] = {}
    with _uncollected():
        for definition in definitions:
            with contextlib.suppress(ExmeshError):  # told of where the node is planned
                told.update(dict.fromkeys(_of(definition)))
    return list(told)


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Trees of hundreds of modules hold no circle, and looking for one takes a third of the time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def undeclared(definition: NodeDef) -> list[str]:
    """The installed libraries that a pack's code imports for a type and its declaration (`libraries=`) leaves out."""
    declared, owners = {*map(_canonical, definition.libraries)}, importlib.metadata.packages_distributions()
    return sorted(
        name for name in outside_imports(definition, but_not_of=(OWN,))
        if name in owners and not declared & {_canonical(owner) for owner in owners[name]}
    )  # fmt: skip


def outside_imports(definition: NodeDef, but_not_of: tuple[str, ...] = ()) -> set[str]:
    """Top names of what a node type's code imports from neither the project nor the standard library."""
    sources = current().part(Sources)
    modules = [sources.module(name) for name in sources.fingerprint(definition).modules]
    own = {OWN, *(module.name.partition(".")[0] for module in modules)} | sys.stdlib_module_names
    asked = [module for module in modules if module.name.partition(".")[0] not in but_not_of]
    return {name.partition(".")[0] for module in asked for name, _ in module.imports} - own


def _of(definition: NodeDef) -> list[str]:
    sources, own = current().part(Sources), definition.function.__module__
    made = sources.fingerprint(definition)
    found = {name: _in_module(sources, sources.module(name)) for name in made.modules}
    lent = {f"{name}.{short}": words for name, one in found.items() for short, words in one["lent"].items()}
    told, kept = _strangers(sources, found, made.lines, own), _kept(sources, found, definition)
    for name, one in found.items():
        places = [*one["places"], *kept[name], *((line, lent[full]) for line, full in one["taken"] if full in lent)]
        told += [
            f"{name}:{line}: {words}" for line, words in sorted(map(tuple, places)) if name != own or line in made.lines
        ]
    if own == "__main__":
        with contextlib.suppress(OSError, TypeError, SyntaxError):
            source = textwrap.dedent(inspect.getsource(definition.function))
            told += [f"{own}:{line}: {words}" for line, words in unseen_in(ast.parse(source), source.splitlines())]
    return told


def _kept(sources: Sources, found: Mapping[str, Any], definition: NodeDef) -> dict[str, list[tuple[int, str]]]:
    """{module: (line, words) of what its functions keep from call to call}; not of those that only imports call."""
    ends = {part for one in found.values() for _, dotted in one["uses"] for part in dotted.split(".")}
    methods = {name for one in found.values() for name in one["inner"] if name.startswith(".")}
    methods |= {f".{part}" for part in ends}
    told: dict[str, list[tuple[int, str]]] = {}
    for name, one in found.items():
        called = {*one["inner"], *ends, definition.function.__name__, ""}
        told[name] = [
            (line, words) for line, words, owner in one["keeps"]
            if owner in called or f".{owner.partition('.')[2]}" in methods or owner.endswith("__")
        ]  # fmt: skip
        told[name] += [
            (line, f"what is kept from call to call ({dotted})") for line, dotted in one["uses"]
            if any(is_changed(found[home]["state"], rest[0], rest[1:]) for home, rest in _split(sources, found, dotted))
        ]  # fmt: skip
        told[name] += [
            (line, f"a module that nothing here imports ({module})") for line, dotted in one["uses"]
            for module in _loaded(dotted) if module not in found and _has_code(sources, module)
        ]  # fmt: skip
    return told


def _loaded(dotted: str) -> list[str]:
    """The modules of several names that a dotted name goes through, but its first."""
    parts = dotted.split(".")
    return [name for k in range(2, len(parts) + 1) if (name := ".".join(parts[:k])) in sys.modules]


def _has_code(sources: Sources, name: str) -> bool:
    return not is_ignored(name) and sources.find(name) is not None and sources.module(name).exports is None


def _strangers(sources: Sources, found: Mapping[str, Any], lines: Collection[int], own: str) -> list[str]:
    """What other modules of the pack, or other lines of the node's own, change in those of a key on import."""
    top, told = own.partition(".")[0], []
    for name in sorted(name for name in sys.modules if name.partition(".")[0] == top and not is_ignored(name)):
        if (name in found and name != own) or top == "__main__" or sources.find(name) is None:
            continue
        for line, dotted, is_set in _in_module(sources, sources.module(name))["acts"]:
            fills = is_set and dotted.partition(".")[0] != top
            for module, rest in _split(sources, found, dotted):
                one, fills = found[module], fills or is_set
                if module.partition(".")[0] == top:  # deriving from a wire type of the framework is nothing of the kind
                    tables = {name: methods for name, methods in one["state"].items() if methods != ["*"]}
                    fills |= rest[0] in (*one["hooked"], *(owner for _, _, owner in one["keeps"]))
                    fills |= is_changed(tables, rest[0], rest[1:])
            if fills and (name != own or line not in lines):
                told.append(f"{name}:{line}: what it changes when it is imported ({dotted})")
    return told


def _split(sources: Sources, found: Mapping[str, Any], dotted: str) -> list[tuple[str, list[str]]]:
    """A dotted name as (module of the key, what it has), also where another module only hands it on."""
    parts = dotted.split(".")
    for _ in range(8):
        heads = [".".join(parts[:k]) for k in range(1, len(parts))]
        known = [k for k, head in enumerate(heads, 1) if head in sys.modules or head in found]
        module, rest = ".".join(parts[: max(known, default=0)]), parts[max(known, default=0) :]
        exports = (sources.module(module).exports if known and sources.find(module) else None) or {}
        if rest[0] not in exports:
            return [(module, rest)] if module in found else []
        parts = [*".".join(filter(None, exports[rest[0]])).split("."), *rest[1:]]
    return []


def _in_module(sources: Sources, text: ModuleText) -> dict[str, Any]:
    return dict(sources.fact(text, _fact(), functools.partial(_looked, text)))


def _looked(text: ModuleText) -> dict[str, Any]:
    found = looked_at(text.tree, text.data.decode("utf-8", "replace").splitlines(), text.package)
    # read again where it is asked for: the trees of all modules are as slow to keep as to make
    vars(text).pop("tree", None)
    return found


@functools.cache
def _fact() -> str:
    rules = (Path(__file__).with_name(f"{name}.py") for name in ("reach", "fixed", "standard", "kept", "places"))
    return "unseen " + " ".join(sha256_file(path)[:16] for path in [*rules, Path(pythontree.__file__)])


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
