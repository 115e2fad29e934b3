"""The code fingerprint of a node: which source text its result depends on, without importing any of it.

It covers the node function, the module-level definitions that the function uses (transitively, its Params and output
classes included), and every project module that these import, transitively and also inside functions. Project modules
are those of exmesh_graph (but for graph, api, notebook, cli: they change no result) and of the node's own pack.
Comments, docstrings, formatting, `param(...)` declarations (their values are in the key) and the `@node(...)`
decorator do not count; decorators, calls and subclasses that may fill a table when the module is imported do. Not
seen: modules imported by a computed name or only for their effect, what other modules patch or register, docstrings
read as data, data files of a package (declare `code=` and `version=`, or make them sources), and installed libraries
(declare `libraries=`).

What a module's text says (its digest, imports, slices) is remembered from one process to the next by its bytes; the
bytes of every module are read each time, so that an edit is never missed.
"""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.live import MAIN, Live
from exmesh_graph.graph.cache.moduletext import (
    OWN,
    ModuleText,
    bytecode_is_older,
    drop_stale_bytecode,
    is_ignored,
    sha,
    source_file,
    spec_of,
    stamp_of,
    text_of,
)
from exmesh_graph.graph.cache.syntax import Import
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.sealed import Memo

_PYTHON = Path(importlib.__file__).parents[1]  # told by its place: a file of yours may have the name of one of these
ABSENT = "absent"  # the digest of a module of the pack that is not there


@dataclass(frozen=True)
class Fingerprint:
    """The digest that goes into the key, and the parts it was made of: {module: digest}.

    `lines` are those of the definition's own module that count.
    """

    digest: str
    parts: dict[str, str]
    modules: tuple[str, ...]
    lines: tuple[int, ...] = ()


def fingerprint(definition: NodeDef) -> Fingerprint:
    """The code fingerprint of a node type, as its source files were when the current session first looked."""
    return current().part(Sources).fingerprint(definition)


def remember_in(memo: Memo) -> None:
    """Let the current session look up and keep in `memo` what the text of modules says."""
    current().part(Sources).memo = memo


def sources_changed(definition: NodeDef) -> list[str]:
    """Modules of the fingerprint whose code was edited since: what ran may not be what was fingerprinted."""
    sources = current().part(Sources)
    names = sources.fingerprint(definition).modules
    return [name for name in names if sources.module(name).is_edited() or sources.outlived(name)]


def _is_installed(path: Path) -> bool:
    return path.is_relative_to(_PYTHON) or any(part in ("site-packages", "dist-packages") for part in path.parts)


_loads: list[int] = []  # one entry for each time that a session found modules edited or loaded anew
_facts: dict[str, dict[str, Any]] = {}  # of this process: {ModuleText.key: what this text says}, whatever store is open
_loaded: dict[str, tuple[Any, bytes, int]] = {}  # of this process: {module: (spec, the text it was loaded from, when)}


class Sources:
    """The source text of modules as a session first found it, and the fingerprints of node types made of it."""

    def __init__(self) -> None:
        self.memo: Memo | None = None
        self.modules: dict[str, ModuleText] = {}
        self.paths: dict[str, Path | None] = {}
        self.fingerprints: dict[tuple[str, str, tuple[str, ...]], Fingerprint] = {}

    def fingerprint(self, definition: NodeDef) -> Fingerprint:
        """That of a node or component type. Raises GraphError where its source cannot be found."""
        module, function = definition.function.__module__, definition.function.__name__
        if module == MAIN:
            live = Live(definition.function)
            return self._with_modules(live.parts, live.imports, [], definition)
        key = module, function, definition.code
        if key not in self.fingerprints:
            part, imports, lines = self.module(module).slice(function)
            self.fingerprints[key] = self._with_modules({f"{module}:{function}": part}, imports, lines, definition)
        return self.fingerprints[key]

    def module(self, name: str) -> ModuleText:
        """The text of a module. Raises GraphError where there is none."""
        if name not in self.modules:
            self.modules[name] = self._read(name)
        return self.modules[name]

    def find(self, name: str) -> Path | None:
        """The source file of a module, found without importing it; None when there is none."""
        if name not in self.paths:
            self.paths[name] = source_file(name)
        return self.paths[name]

    def refresh(self) -> None:
        """Look again at modules whose file was edited, or which were loaded anew: a session may live for days."""
        changed = [module.name for module in self.modules.values() if not module.is_current()]
        absent = {name for made in self.fingerprints.values() for name, part in made.parts.items() if part == ABSENT}
        if changed or any(source_file(name) for name in absent):
            _loads.append(len(_loads))
            self.fingerprints.clear()
            self.paths.clear()
            for name in changed:
                del self.modules[name]

    def outlived(self, name: str) -> bool:
        """Whether a loaded module holds names of one that was loaded anew after it."""
        taken = {other for other, attribute in self.module(name).imports if attribute}
        own = _loaded[name][2] if name in _loaded else len(_loads)
        return any(_loaded[other][2] > own for other in taken & self.modules.keys() & _loaded.keys())

    def fact(self, module: ModuleText, name: str, find: Callable[[], Any]) -> Any:
        """What `find` finds out about a module of exactly these bytes, once: this process and the memo keep it."""
        known = {} if self.memo is None else self.memo.known.get(module.key, {})
        facts = _facts.setdefault(module.key, {})
        if name not in facts:
            facts[name] = known[name] if name in known else find()
        if self.memo is not None and name not in known:
            self.memo.put(module.key, {**known, name: facts[name]})
        return facts[name]

    def _with_modules(
        self, parts: dict[str, str], imports: list[Import], lines: list[int], definition: NodeDef
    ) -> Fingerprint:
        """The fingerprint of a definition of these parts, with the project modules that they import."""
        code, module = definition.code, definition.function.__module__
        for name in code:
            if self.find(name) is None:
                what = f"code={name!r} of the node {definition.function.__qualname__} in {module} is no module"
                raise GraphError(what)
        tops = {OWN, *self._siblings(module.partition(".")[0]), *(name.partition(".")[0] for name in code)}
        followed: dict[str, str] = {}
        modules = list(self._closure([*imports, *((name, None) for name in code)], frozenset(tops), followed))
        texts = [self.module(name) for name in modules if self.find(name) is not None]
        found = dict.fromkeys(modules, ABSENT) | {text.name: text.digest for text in texts}
        parts = dict(sorted({**parts, **found, **followed}.items()))
        digest = sha("\n".join(f"{name} {part}" for name, part in parts.items()))
        names = {name.partition(":")[0] for name, part in parts.items() if part != ABSENT} - {MAIN}
        return Fingerprint(digest, parts, tuple(sorted(names)), tuple(lines))

    def _siblings(self, top: str) -> set[str]:
        """A pack's top-level package, and those that came with it in one installed distribution."""
        path = self.find(top)
        if path is None or not _is_installed(path):
            return {top}
        owners = importlib.metadata.packages_distributions()
        return {top, *(name for name, of in owners.items() if set(of) & set(owners.get(top, ())))}

    def _local(self, name: str, attribute: str | None) -> bool:
        """Whether an import is of a file of the user's own, not one of Python's or of an installed library."""
        path = self.find(name) or self.find(f"{name}.{attribute}")
        return name.partition(".")[0] != MAIN and path is not None and not _is_installed(path)

    def _closure(self, imports: Iterable[Import], tops: frozenset[str], followed: dict[str, str]) -> Iterator[str]:
        """The project modules reachable from `imports`.

        `followed` gets what stands behind each name that a package only re-exports: it counts beside the texts, since
        all of these may be there before and after another one is chosen.
        """
        seen: set[Import] = set()
        done: set[str] = set()
        todo = list(imports)
        while todo:
            item = todo.pop()
            if item in seen:
                continue
            seen.add(item)
            name, attribute = item
            known = name != MAIN and name.partition(".")[0] in tops
            if is_ignored(name) or not (known or self._local(name, attribute)):
                continue
            exports = self.module(name).exports if attribute is not None and self.find(name) else None
            if exports and attribute in exports:
                todo.append(exports[attribute])
                followed[f"{name}:{attribute}"] = " ".join(map(str, exports[attribute]))
            if attribute and self.find(f"{name}.{attribute}") is not None:
                todo += [(f"{name}.{attribute}", None), (name, "")]
                continue
            if name == OWN or (attribute == "" and self.find(name) is None):
                continue  # the front door, which no room below uses; a package without a file of its own
            if "." in name:
                todo.append((name.rpartition(".")[0], ""))
            if self.find(name) is None and (sys.modules.get(name) is None or hasattr(sys.modules[name], "__path__")):
                # an import that is tried and may fail; a package without a file of its own
                yield name
                continue
            if exports is not None and (attribute == "" or attribute in exports):
                continue
            if name not in done:
                done.add(name)
                yield name
                todo += self.module(name).imports

    def _read(self, name: str) -> ModuleText:
        path = self.find(name)
        if path is None:
            raise GraphError(f"the source of the module {name} cannot be found", fix="install it as plain .py files")
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        stamp, data, spec = stamp_of(path), path.read_bytes(), spec_of(name)
        stale = drop_stale_bytecode(path, data) and spec is not None
        if spec is not None and (name not in _loaded or _loaded[name][0] is not spec):
            stale = stale or bytecode_is_older(path)
            _loaded[name] = spec, b"" if stale else data, len(_loads) if name in _loaded else 0
        elif spec is not None and _loaded[name][1] != data:
            stale = stale or text_of(_loaded[name][1]) != text_of(data)
        return ModuleText(self.fact, name, data, package, path, stamp, stale, spec)
