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

from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import sha256_file
from exmesh_graph.graph.cache.fingerprint import Sources
from exmesh_graph.graph.cache.moduletext import OWN, ModuleText
from exmesh_graph.graph.cache.syntax import LOADERS, imports_in, last_of, text_of
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current

_ENVIRONMENT = re.compile(r"(?:os\.)?(?:environb?(?:\.get)?|getenvb?)\Z")
_OF_ENVIRONMENT = ("environ", "environb", "get", "getenv", "getenvb")  # what such a name ends in: asked first
_BESIDE = ("importlib.resources", "importlib_resources", "pkgutil")
_RUNNERS = (*LOADERS, "exec_module", "run_path", "run_module")
_READERS = re.compile(
    r"(?:io\.|os\.)?open|(?:pathlib\.)?(?:Pure)?Path|(?:\w+\.)*(?:(?:im)?read\w*|load\w*|\w*from_?(?:file|txt)\w*|memmap)\Z"
)
_PSEUDO = ("/proc/", "/sys/", "/dev/")
_HARMLESS = "# not in the key"
_looked_at: dict[str, list[tuple[int, str]]] = {}
"""What was found in modules of these bytes (`ModuleText.key`), for where there is no store whose memo knows."""


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
    told = []
    for name in made.modules:
        text = sources.module(name)
        found = sources.fact(text, _fact(), functools.partial(_in_module, text))
        told += [f"{name}:{line}: {words}" for line, words in found if name != own or line in made.lines]
    if own == "__main__":
        with contextlib.suppress(OSError, TypeError, SyntaxError):
            source = textwrap.dedent(inspect.getsource(definition.function))
            told += [f"{own}:{line}: {words}" for line, words in unseen_in(ast.parse(source), source.splitlines())]
    return told


def _in_module(text: ModuleText) -> list[tuple[int, str]]:
    if text.key not in _looked_at:
        _looked_at[text.key] = unseen_in(text.tree, text.data.decode("utf-8", "replace").splitlines())
    return _looked_at[text.key]


@functools.cache
def _fact() -> str:
    return f"unseen {sha256_file(Path(__file__))}"


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def unseen_in(tree: ast.AST, lines: list[str]) -> list[tuple[int, str]]:
    """(line, words) of every such place; `lines` are those of the whole file."""
    told: dict[int, str] = {}
    for item in ast.walk(tree):
        if isinstance(item, ast.expr | ast.stmt) and (words := _words(item)) and not _harmless(lines, item.lineno):
            told.setdefault(item.lineno, words)
    return sorted(told.items())


def _harmless(lines: list[str], line: int) -> bool:
    """Whether a line, or a comment above it, says that what it does changes no result."""
    above = lines[line - 2].strip() if line > 1 else ""
    return _HARMLESS in lines[line - 1] or above.startswith(_HARMLESS)


def _words(item: ast.AST) -> str:
    """What one piece of syntax depends on; an empty text for nothing else."""
    if isinstance(item, ast.Name | ast.Attribute) and _is_environment(item):
        return "the environment"
    if isinstance(item, ast.Name) and item.id == "__file__":
        return "files beside the module (__file__)"
    if isinstance(item, ast.Import | ast.ImportFrom):
        beside = any(f"{module}.{name}".startswith(_BESIDE) for module, name in imports_in(item, ""))
        return "files beside the module (resources of a package)" if beside else ""
    if not isinstance(item, ast.Call):
        return ""
    name, text = last_of(item.func), text_of(item)
    if isinstance(item.func, ast.Name) and name in ("eval", "exec"):
        return f"code that is a text ({name})"
    if isinstance(item.func, ast.Name) and name == "globals":
        return "names that are texts (globals)"
    if name in _RUNNERS and not text:
        return f"code by a computed name ({ast.unparse(item)[:60]})"
    if text and not text.startswith(_PSEUDO) and _READERS.fullmatch(ast.unparse(item.func)):
        return f"the file {text!r}"
    return f"the environment ({text})" if text and _is_environment(item.func) else ""


def _is_environment(item: ast.expr) -> bool:
    """Whether a name is one of the environment's. Syntax is turned into text slowly, so its end is looked at first."""
    return last_of(item) in _OF_ENVIRONMENT and bool(_ENVIRONMENT.match(ast.unparse(item)))
