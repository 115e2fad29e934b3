"""What a node's code depends on that no text of modules can tell: the environment, files, computed code and imports.

It is told, and not keyed: by `why`, `plan` and `doctor`. A line is left out that ends in `# not in the key: reason`,
or has such a comment above it.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib.metadata
import inspect
import re
import sys
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from exmesh_graph.api.reach import looked_at, unseen_in
from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import sha256_file
from exmesh_graph.graph.cache.fingerprint import Sources
from exmesh_graph.graph.cache.moduletext import OWN, ModuleText
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current


def unseen(definitions: Iterable[NodeDef]) -> list[str]:
    """`module:line: words` of every place in the code of nodes and components; what cannot be read is left out."""
    told: dict[str, None] = {}
    for definition in definitions:
        with contextlib.suppress(ExmeshError):  # told of where the node is planned
            told.update(dict.fromkeys(_of(definition)))
    return list(told)


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
    told = []
    for name, one in found.items():
        places = [*one["places"], *((line, lent[full]) for line, full in one["taken"] if full in lent)]
        told += [
            f"{name}:{line}: {words}" for line, words in sorted(map(tuple, places)) if name != own or line in made.lines
        ]
    if own == "__main__":
        with contextlib.suppress(OSError, TypeError, SyntaxError):
            source = textwrap.dedent(inspect.getsource(definition.function))
            told += [f"{own}:{line}: {words}" for line, words in unseen_in(ast.parse(source), source.splitlines())]
    return told


def _in_module(sources: Sources, text: ModuleText) -> dict[str, Any]:
    return dict(sources.fact(text, _fact(), functools.partial(_looked, text)))


def _looked(text: ModuleText) -> dict[str, Any]:
    return looked_at(text.tree, text.data.decode("utf-8", "replace").splitlines(), text.package)


@functools.cache
def _fact() -> str:
    rules = (Path(__file__).with_name(f"{name}.py") for name in ("reach", "fixed", "standard"))
    return "unseen " + " ".join(sha256_file(path)[:16] for path in rules)


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
