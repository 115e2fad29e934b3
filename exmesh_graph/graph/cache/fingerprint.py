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

import ast
import contextlib
import functools
import hashlib
import importlib.util
import marshal
import os
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import MAGIC_NUMBER
from pathlib import Path
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache import syntax
from exmesh_graph.graph.cache.live import MAIN, Live
from exmesh_graph.graph.cache.syntax import (
    Import,
    acts,
    bound_by,
    imports_in,
    is_node_decorator,
    is_text,
    normalised,
    used_by,
)
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.files import Memo

OWN = "exmesh_graph"
IGNORED = ("exmesh_graph.graph", "exmesh_graph.cli", "exmesh_graph.api", "exmesh_graph.notebook", "exmesh_graph.params")


@dataclass(frozen=True)
class Fingerprint:
    """The digest that goes into the key, and the parts it was made of: {module: digest}."""

    digest: str
    parts: dict[str, str]
    modules: tuple[str, ...]


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
    return [name for name in names if _edited(sources.module(name)) or sources.outlived(name)]


def outside_imports(definition: NodeDef) -> set[str]:
    """Top names of what a node type's code imports from neither the project nor the standard library."""
    sources = current().part(Sources)
    modules = [sources.module(name) for name in sources.fingerprint(definition).modules]
    own = {OWN, *(module.name.partition(".")[0] for module in modules)}
    return {name.partition(".")[0] for module in modules for name, _ in module.imports} - own - sys.stdlib_module_names


_loads: list[int] = []  # one entry for each time that a session found modules edited or loaded anew
_loaded: dict[str, tuple[Any, bytes, int]] = {}  # of this process: {module: (spec, the text it was loaded from, when)}


class Sources:
    """The source text of modules as a session first found it, and the fingerprints of node types made of it."""

    def __init__(self) -> None:
        self.memo: Memo | None = None
        self.modules: dict[str, _Module] = {}
        self.paths: dict[str, Path | None] = {}
        self.fingerprints: dict[tuple[str, str, tuple[str, ...]], Fingerprint] = {}

    def fingerprint(self, definition: NodeDef) -> Fingerprint:
        """That of a node or component type. Raises GraphError where its source cannot be found."""
        if definition.function.__module__ == MAIN:
            return self._live(definition)
        key = definition.function.__module__, definition.function.__name__, definition.code
        if key not in self.fingerprints:
            self.fingerprints[key] = self._fingerprint(*key)
        return self.fingerprints[key]

    def module(self, name: str) -> _Module:
        """The text of a module. Raises GraphError where there is none."""
        if name not in self.modules:
            self.modules[name] = self._read(name)
        return self.modules[name]

    def find(self, name: str) -> Path | None:
        """The source file of a module, found without importing it; None when there is none."""
        if name not in self.paths:
            self.paths[name] = _source_file(name)
        return self.paths[name]

    def refresh(self) -> None:
        """Look again at modules whose file was edited, or which were loaded anew: a session may live for days."""
        changed = [m.name for m in self.modules.values() if m.stamp != _stamp(m.path) or m.spec is not _spec(m.name)]
        if changed:
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

    def fact(self, module: _Module, name: str, find: Callable[[], Any]) -> Any:
        """What the memo holds under `name` for a module of exactly these bytes, else what `find` finds out."""
        facts = {} if self.memo is None else self.memo.known.get(module.key, {})
        if name not in facts:
            facts = {**facts, name: find()}
            if self.memo is not None:
                self.memo.put(module.key, facts)
        return facts[name]

    def _fingerprint(self, module: str, function: str, code: tuple[str, ...]) -> Fingerprint:
        part, imports = self.module(module).slice(function)
        return self._with_modules({f"{module}:{function}": part}, imports, module, function, code)

    def _live(self, definition: NodeDef) -> Fingerprint:
        """That of what a script or a notebook defines, as it is now."""
        live = Live(definition.function)
        return self._with_modules(live.parts, live.imports, MAIN, definition.function.__qualname__, definition.code)

    def _with_modules(
        self, parts: dict[str, str], imports: list[Import], module: str, function: str, code: tuple[str, ...]
    ) -> Fingerprint:
        for name in code:
            if self.find(name) is None:
                raise GraphError(f"code={name!r} of the node {function} in {module} is no module")
        tops = {OWN, module.partition(".")[0], *(name.partition(".")[0] for name in code)}
        modules = list(self._closure([*imports, *((name, None) for name in code)], frozenset(tops)))
        parts = dict(sorted({**parts, **{name: self.module(name).digest for name in modules}}.items()))
        digest = _sha("\n".join(f"{name} {part}" for name, part in parts.items()))
        return Fingerprint(digest, parts, tuple(sorted({name.partition(":")[0] for name in parts} - {MAIN})))

    def _local(self, top: str) -> bool:
        """Whether a module is a file of the user's own, not one of Python's or of an installed library."""
        if top in sys.stdlib_module_names or top == MAIN:
            return False
        path = self.find(top)
        return path is not None and not any(part in ("site-packages", "dist-packages") for part in path.parts)

    def _closure(self, imports: Iterable[Import], tops: frozenset[str]) -> Iterator[str]:
        """The project modules reachable from `imports`."""
        seen: set[Import] = set()
        done: set[str] = set()
        todo = list(imports)
        while todo:
            item = todo.pop()
            if item in seen:
                continue
            seen.add(item)
            name, attribute = item
            top = name.partition(".")[0]
            if not ((top in tops and top != MAIN) or self._local(top)) or _ignored(name):
                continue
            if attribute and self.find(f"{name}.{attribute}") is not None:
                todo.append((f"{name}.{attribute}", None))
                todo += [(name, ""), *self._same_name(name, attribute)]
                continue
            if name == OWN:  # the front door: what it names is in none of the rooms below
                continue
            if "." in name:
                todo.append((name.rpartition(".")[0], ""))
            module = self.module(name)
            if module.exports is not None and attribute is not None:
                if attribute in module.exports:
                    todo.append(module.exports[attribute])
                if attribute == "" or attribute in module.exports:
                    continue
            if name not in done:
                done.add(name)
                yield name
                todo += module.imports

    def _same_name(self, package: str, attribute: str) -> list[Import]:
        """Where a package takes a name from that is the name of one of its modules as well."""
        exports = self.module(package).exports if self.find(package) else None
        return [exports[attribute]] if exports and attribute in exports else []

    def _read(self, name: str) -> _Module:
        path = self.find(name)
        if path is None:
            raise GraphError(f"the source of the module {name} cannot be found", fix="install it as plain .py files")
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        stamp, data, spec = _stamp(path), path.read_bytes(), _spec(name)
        stale = _drop_stale_bytecode(path, data) and spec is not None
        if spec is not None and (name not in _loaded or _loaded[name][0] is not spec):
            stale = stale or _bytecode_is_older(path)
            _loaded[name] = spec, b"" if stale else data, len(_loads) if name in _loaded else 0
        elif spec is not None and _loaded[name][1] != data:
            stale = stale or _text_of(_loaded[name][1]) != _text_of(data)
        return _Module(self.fact, name, data, package, path, stamp, stale, spec)


def _ignored(name: str) -> bool:
    return any(name == i or name.startswith(i + ".") for i in IGNORED)


@dataclass(frozen=True)
class _Module:
    fact: Callable[[_Module, str, Callable[[], Any]], Any]
    name: str
    data: bytes
    package: str
    path: Path
    stamp: tuple[int, ...] | None
    stale: bool
    spec: Any

    @functools.cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.data, str(self.path))

    @functools.cached_property
    def key(self) -> str:
        return hashlib.sha256(f"{_reader()} {self.package} {self.name}\n".encode() + self.data).hexdigest()

    @functools.cached_property
    def imports(self) -> list[Import]:
        return _pairs(self.fact(self, "imports", lambda: list(imports_in(self.tree, self.package))))

    @functools.cached_property
    def digest(self) -> str:
        return str(self.fact(self, "digest", lambda: _sha(normalised(self.tree))))

    @functools.cached_property
    def exports(self) -> dict[str, Import] | None:
        """{name: where it comes from} of a module that only re-exports, None for any other."""
        found = self.fact(self, "exports", lambda: _exports(self.tree, self.package))
        return None if found is None else {name: (item[0], item[1]) for name, item in found.items()}

    def slice(self, function: str) -> tuple[str, list[Import]]:
        """(digest, imports) of the part of the module that `function` uses."""

        def find() -> tuple[str, list[Import]]:
            text, imports = _Slice(self).of(function)
            return _sha(text), imports

        digest, imports = self.fact(self, "slice " + function, find)
        return digest, _pairs(imports)


def _pairs(items: Iterable[Sequence[Any]]) -> list[Import]:
    return [(item[0], item[1]) for item in items]


def _exports(tree: ast.Module, package: str) -> dict[str, Import] | None:
    found: dict[str, Import] = {}
    for statement in tree.body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            if any(name is None for _, name in imports_in(statement, package)):
                return None
            if isinstance(statement, ast.ImportFrom):
                for alias, item in zip(statement.names, imports_in(statement, package), strict=True):
                    found[alias.asname or alias.name] = item
        elif isinstance(statement, ast.Assign):
            targets = [t.id for t in statement.targets if isinstance(t, ast.Name)]
            if not all(t.startswith("__") for t in targets) or len(targets) != len(statement.targets):
                return None
        elif not is_text(statement):
            return None
    return found


@functools.cache
def _reader() -> str:
    """What a remembered fact depends on beside the bytes: this very reader, and the grammar."""
    own = b"".join(path.read_bytes() for path in (Path(__file__), Path(syntax.__file__)))
    return f"{hashlib.sha256(own).hexdigest()} {sys.version_info[:2]}"


def _edited(module: _Module) -> bool:
    if module.stale:
        return True
    if module.stamp == _stamp(module.path):
        return False
    try:
        data = module.path.read_bytes()
        return data != module.data and _sha(normalised(ast.parse(data))) != module.digest
    except (OSError, SyntaxError):
        return True


def _drop_stale_bytecode(path: Path, data: bytes) -> bool:
    """Whether Python took, or would take, bytecode of other source for this file, which is removed.

    Python goes by size and whole seconds: a second edit within a second, or one that keeps the time, escapes it.
    """
    with contextlib.suppress(OSError, ValueError, EOFError, TypeError, SyntaxError):
        cache, status = Path(importlib.util.cache_from_source(str(path))), path.stat()
        if cache.stat().st_mtime_ns > status.st_ctime_ns:
            return False
        held = cache.read_bytes()
        taken = struct.pack("<4sLLL", MAGIC_NUMBER, 0, int(status.st_mtime) & 0xFFFFFFFF, len(data) & 0xFFFFFFFF)
        if held[:16] == taken and marshal.loads(held[16:]) != compile(data, str(path), "exec", dont_inherit=True):
            cache.unlink()
            return True
    return False


def _bytecode_is_older(path: Path) -> bool:
    """Whether the bytecode that Python wrote when it loaded a module is of an earlier text than the file's."""
    with contextlib.suppress(OSError, NotImplementedError):
        cache, status = Path(importlib.util.cache_from_source(str(path))), path.stat()
        head = cache.read_bytes()[:16]
        if len(head) == 16 and head[4:8] == bytes(4) and os.access(cache.parent, os.W_OK):
            return head[8:] != struct.pack("<LL", int(status.st_mtime) & 0xFFFFFFFF, status.st_size & 0xFFFFFFFF)
    return False


def _text_of(data: bytes) -> str:
    try:
        return normalised(ast.parse(data))
    except SyntaxError:
        return repr(data)


def _spec(name: str) -> Any:
    """Stands for one loading of a module: another one after a reload; None where it is not loaded."""
    return getattr(sys.modules.get(name), "__spec__", None)


def _stamp(path: Path) -> tuple[int, ...] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size


def _source_file(name: str) -> Path | None:
    top, _, rest = name.partition(".")
    roots: list[str] = []
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
        return Path(file) if file and file.endswith(".py") else None
    for root in roots:
        base = os.path.join(root, *rest.split("."))
        for path in (os.path.join(base, "__init__.py"), base + ".py"):
            if os.path.isfile(path):
                return Path(path)
    return None


class _Slice:
    """The part of a module that one of its functions depends on."""

    def __init__(self, module: _Module) -> None:
        self.module = module
        self.binders: dict[str, list[int]] = {}
        self.always: list[int] = []
        own, classes = self._own(), {item.name for item in module.tree.body if isinstance(item, ast.ClassDef)}
        for index, statement in enumerate(module.tree.body):
            names = set(bound_by(statement))
            for name in names:
                self.binders.setdefault(name, []).append(index)
            if not is_text(statement) and (not names or acts(statement, own)):
                self.always.append(index)
            if isinstance(statement, ast.ClassDef) and not any(map(is_node_decorator, statement.decorator_list)):
                for base in statement.bases:  # subclasses can be found from their base: __init_subclass__, registries
                    if isinstance(base, ast.Name) and base.id in classes:
                        self.binders.setdefault(base.id, []).append(index)

    def of(self, function: str) -> tuple[str, list[Import]]:
        """(normalised text, imports) of everything `function` uses."""
        body = self.module.tree.body
        if function not in self.binders:
            raise GraphError(f"{self.module.name} has no function {function} at its top level")
        chosen: set[int] = set()
        todo = [*self.binders[function], *self.always]
        while todo:
            index = todo.pop()
            if index in chosen:
                continue
            chosen.add(index)
            for name in used_by(body[index]):
                todo += self.binders.get(name, [])
        texts, imports = [], []
        for index in sorted(chosen):
            statement = body[index]
            if isinstance(statement, ast.Import | ast.ImportFrom):
                used = {name for i in chosen if i != index for name in used_by(body[i])}
                pairs = zip(statement.names, imports_in(statement, self.module.package), strict=True)
                for alias, item in pairs:
                    if alias.name == "*" or (alias.asname or alias.name).partition(".")[0] in used:
                        imports.append(item)
                        texts.append(f"import {alias.asname or alias.name} {item}")
            else:
                texts.append(normalised(statement))
                imports += imports_in(statement, self.module.package)
        return "\n".join(texts), imports

    def _own(self) -> set[str]:
        """Names that stand for something of the project, its framework left out."""
        found = set()
        tops = (OWN, self.module.name.partition(".")[0])
        for statement in self.module.tree.body:
            origins = [name for name, _ in imports_in(statement, self.module.package)]
            if not origins or any(name.partition(".")[0] in tops and not _ignored(name) for name in origins):
                found |= set(bound_by(statement))
        return found


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
