"""The text of one module: what it imports and re-exports, its digest, and the part that one of its functions uses.

And which text this process has loaded: an edit must not pass for what runs.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import functools
import hashlib
import importlib.util
import marshal
import os
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import MAGIC_NUMBER
from pathlib import Path
from typing import Any

from exmesh_graph import pythontree
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache import syntax
from exmesh_graph.graph.cache.syntax import Import

OWN = "exmesh_graph"
_SUFFIXES = (*EXTENSION_SUFFIXES, ".py", ".pyc")  # in Python's order
IGNORED = ("exmesh_graph.graph", "exmesh_graph.cli", "exmesh_graph.api", "exmesh_graph.notebook", "exmesh_graph.params")


def is_ignored(name: str) -> bool:
    return any(name == i or name.startswith(i + ".") for i in IGNORED)


@dataclass(frozen=True)
class ModuleText:
    fact: Callable[[ModuleText, str, Callable[[], Any]], Any]
    name: str
    data: bytes
    package: str
    path: Path
    stamp: tuple[int, ...] | None
    stale: bool
    spec: Any

    @functools.cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.data if self.path.suffix == ".py" else b"", str(self.path))

    @functools.cached_property
    def names(self) -> dict[str, str]:
        return syntax.framework_names(self.tree, self.package)

    @functools.cached_property
    def key(self) -> str:
        return hashlib.sha256(f"{_reader()} {self.package} {self.name}\n".encode() + self.data).hexdigest()

    @functools.cached_property
    def imports(self) -> list[Import]:
        found = self.fact(self, "imports", lambda: list(syntax.imports_in(self.tree, self.package)))
        return [(module, name) for module, name in found]  # as JSON they were lists

    @functools.cached_property
    def digest(self) -> str:
        if self.path.suffix != ".py":  # compiled
            return hashlib.sha256(self.data).hexdigest()
        return str(self.fact(self, "digest", lambda: sha(syntax.normalised(self.tree, self.names))))

    @functools.cached_property
    def exports(self) -> dict[str, Import] | None:
        """{name: where it comes from} of a module that only re-exports, None for any other."""
        known = self.fact(self, "exports", lambda: _exports(self.tree, self.package))
        return None if known is None else {name: (item[0], item[1]) for name, item in known.items()}

    def is_current(self) -> bool:
        """Whether the file, and what was loaded of it, are still those that this text was read from."""
        return self.stamp == stamp_of(self.path) and self.spec is spec_of(self.name)

    def is_edited(self) -> bool:
        """Whether its code is another one now, or was when it was loaded."""
        if self.stale or self.stamp == stamp_of(self.path):
            return self.stale
        try:
            data = self.path.read_bytes()
        except OSError:
            return True
        # loaded since, and nobody knows of which text: this one may only be back
        return spec_of(self.name) is not self.spec or (data != self.data and text_of(data) != text_of(self.data))

    def slice(self, function: str) -> tuple[str, list[Import], list[int]]:
        """(digest, imports, lines) of the part of the module that `function` uses."""
        digest, imports, lines = self.fact(self, "slice " + function, lambda: _Slice(self).of(function))
        return digest, [(name, part) for name, part in imports], lines


class _Slice:
    """The part of a module that one of its functions depends on."""

    def __init__(self, module: ModuleText) -> None:
        self.module = module
        self.binders: dict[str, list[int]] = {}
        self.always: list[int] = []
        self.bound = {name for statement in module.tree.body for name in syntax.bound_by(statement)}
        own, classes = self._own(), {item.name for item in module.tree.body if isinstance(item, ast.ClassDef)}
        skipped = syntax.declaring(module.tree, module.names)
        self.mentioned = set(syntax.used_by(module.tree))
        for index, statement in enumerate(module.tree.body):
            names = set(syntax.bound_by(statement))
            for name in names:
                self.binders.setdefault(name, []).append(index)
            effect = isinstance(statement, (ast.Import, ast.ImportFrom)) and names & own - self.mentioned
            if not syntax.is_text(statement) and (not names or effect or syntax.acts(statement, own, skipped)):
                self.always.append(index)
            if isinstance(statement, ast.ClassDef) and not skipped & set(map(id, statement.decorator_list)):
                for base in statement.bases:  # subclasses can be found from their base: __init_subclass__, registries
                    if isinstance(base, ast.Name) and base.id in classes:
                        self.binders.setdefault(base.id, []).append(index)

    def of(self, function: str) -> tuple[str, list[Import], list[int]]:
        """(digest of the normalised text, imports, lines) of everything `function` uses."""
        body = self.module.tree.body
        if function not in self.binders:
            raise GraphError(f"{self.module.name} has no function {function} at its top level")
        chosen, todo = set[int](), {*self.binders[function], *self.always}
        while todo:
            chosen.add(index := todo.pop())
            todo.update(*(self.binders.get(name, ()) for name in syntax.used_by(body[index])))
            todo -= chosen
        texts, imports, lines = list[str](), list[Import](), list[int]()
        built = {name for i in chosen for name in syntax.used_by(body[i], annotations=False)}
        for index in sorted(chosen):
            statement = body[index]
            if isinstance(statement, (ast.Import, ast.ImportFrom)):
                used = {name for i in chosen if i != index for name in syntax.used_by(body[i])}
                pairs = zip(statement.names, syntax.imports_in(statement, self.module.package), strict=True)
                for alias, item in pairs:
                    name = (alias.asname or alias.name).partition(".")[0]
                    if alias.name == "*" or name in used or name not in self.mentioned:
                        imports.append(item)
                        texts.append(f"import {alias.asname or alias.name} {item}")
            else:
                made = isinstance(statement, ast.ClassDef) and statement.name in built
                texts.append(syntax.normalised(statement, self.module.names, made))
                imports += syntax.imports_in(statement, self.module.package)
            lines += range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)
        return sha("\n".join(texts)), imports, lines

    def _own(self) -> set[str]:
        """Names that stand for something of the project, its framework left out."""
        own = set()
        tops = (OWN, self.module.name.partition(".")[0])
        for statement in self.module.tree.body:
            pairs = list(syntax.imports_in(statement, self.module.package))
            if not pairs or any(name.partition(".")[0] in tops and not is_ignored(name) for name, _ in pairs):
                own |= set(syntax.bound_by(statement))
                if any(name is None for _, name in pairs if isinstance(statement, ast.ImportFrom)):  # `import *`
                    own |= set(syntax.used_by(self.module.tree)) - self.bound - set(dir(builtins))
        return own


def _exports(tree: ast.Module, package: str) -> dict[str, Import] | None:
    origins: dict[str, Import] = {}
    for statement in tree.body:
        if isinstance(statement, (ast.Import, ast.ImportFrom)):
            if any(name is None for _, name in syntax.imports_in(statement, package)):
                return None
            if isinstance(statement, ast.ImportFrom):
                for alias, item in zip(statement.names, syntax.imports_in(statement, package), strict=True):
                    origins[alias.asname or alias.name] = item
        elif isinstance(statement, ast.Assign):
            targets = [t.id for t in statement.targets if isinstance(t, ast.Name)]
            calls = any(isinstance(item, ast.Call) for item in pythontree.walk(statement))
            if calls or not all(t.startswith("__") for t in targets) or len(targets) != len(statement.targets):
                return None
        elif not syntax.is_text(statement):
            return None
    return origins


@functools.cache
def _reader() -> str:
    """What a remembered fact depends on beside the bytes: this very reader, and the grammar."""
    own = b"".join(path.read_bytes() for path in map(Path, (__file__, syntax.__file__, pythontree.__file__)))
    return f"{hashlib.sha256(own).hexdigest()} {sys.version_info[:2]}"


def sha(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def source_file(name: str) -> Path | None:
    top, _, rest = name.partition(".")
    if top in sys.modules:
        loaded = sys.modules[top]
        file, roots = getattr(loaded, "__file__", None), list(getattr(loaded, "__path__", []))
    else:
        try:
            spec = importlib.util.find_spec(top)
        except (ImportError, ValueError):
            spec = None
        file = spec.origin if spec else None
        roots = list(spec.submodule_search_locations or []) if spec else []
    if not rest:
        return Path(file) if file and file.endswith(_SUFFIXES) else None
    for root in roots:
        base = os.path.join(root, *rest.split("."))
        for path in (os.path.join(base, "__init__.py"), *(base + suffix for suffix in _SUFFIXES)):
            if os.path.isfile(path):
                return Path(path)
    return None


def spec_of(name: str) -> Any:
    """Stands for one loading of a module: another one after a reload; None where it is not loaded."""
    return getattr(sys.modules.get(name), "__spec__", None)


def stamp_of(path: Path) -> tuple[int, ...] | None:
    with contextlib.suppress(OSError):
        status = path.stat()
        return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size
    return None


def drop_stale_bytecode(path: Path, data: bytes) -> bool:
    """Whether Python took, or would take, bytecode of other source for this file, which is removed.

    Python goes by size and whole seconds: a second edit within a second, or one that keeps the time, escapes it.
    """
    with contextlib.suppress(OSError, ValueError, EOFError, TypeError, SyntaxError):
        cache, status = Path(importlib.util.cache_from_source(str(path))), path.stat()
        held = cache.read_bytes()
        unchecked = held[:8] == struct.pack(
            "<4sL", MAGIC_NUMBER, 1
        )  # Python never looks whether the source is the same
        if cache.stat().st_mtime_ns > status.st_ctime_ns and not unchecked:
            return False
        taken = struct.pack("<4sLLL", MAGIC_NUMBER, 0, int(status.st_mtime) & 0xFFFFFFFF, len(data) & 0xFFFFFFFF)
        if (unchecked or held[:16] == taken) and marshal.loads(held[16:]) != compile(
            data, str(path), "exec", dont_inherit=True
        ):
            cache.unlink()
            return True
    return False


def bytecode_is_older(path: Path) -> bool:
    """Whether the bytecode that Python wrote when it loaded a module is of an earlier text than the file's.

    Where Python writes none (PYTHONDONTWRITEBYTECODE), what lies there is of an earlier process and says nothing.
    """
    with contextlib.suppress(OSError, NotImplementedError):
        cache, status = Path(importlib.util.cache_from_source(str(path))), path.stat()
        head = cache.read_bytes()[:16]
        written = not sys.dont_write_bytecode and os.access(cache.parent, os.W_OK)
        if written and len(head) == 16 and head[4:8] == bytes(4):
            return head[8:] != struct.pack("<LL", int(status.st_mtime) & 0xFFFFFFFF, status.st_size & 0xFFFFFFFF)
    return False


def text_of(data: bytes) -> str:
    try:
        return syntax.normalised(tree := ast.parse(data), syntax.framework_names(tree, ""))
    except (SyntaxError, ValueError):  # compiled, or broken
        return repr(data)
