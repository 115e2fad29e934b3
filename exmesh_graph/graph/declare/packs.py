"""Node packs, and what a session knows: its node types, modules that cannot be imported, and its caches.

A pack is a module, or a package of modules, that declares node types. Every entry point of the group `exmesh.nodes`
names an installed one. A declaration goes to the session that is current when its module runs; there is always one,
and `with packs:` makes another one current in this thread.
"""

from __future__ import annotations

import contextlib
import contextvars
import importlib
import importlib.metadata
import pkgutil
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from exmesh_graph.errors import MissingLibraryError

if TYPE_CHECKING:
    from exmesh_graph.graph.declare.node import NodeDef

GROUP = "exmesh.nodes"
T = TypeVar("T")

_named: set[str] = set()  # packs that a session was made for by name
_declared: dict[str, dict[str, NodeDef]] = {}  # what each module declared when it ran last, whoever imported it


class Packs:
    """The node and component types of a session, {type: definition}, and {module: why it could not be imported}.

    `names` are the packs to load, by module or package; None stands for the installed ones and for everything that is
    declared while this session is current.
    """

    def __init__(self, names: Iterable[str] | None = None) -> None:
        self.names = None if names is None else tuple(names)
        self.types: dict[str, NodeDef] = {}
        self.renamed: dict[str, str] = {}  # {a name that a type had before: the one it has now}
        self.broken: dict[str, str] = {}
        self.versions: dict[str, str] = {}  # of distributions, as they were when first asked for
        self.parts: dict[Any, Any] = {}

    def __enter__(self) -> Self:
        _stack.set((*_stack.get(), self))
        return self

    def __exit__(self, *error: object) -> None:
        _stack.set(_stack.get()[:-1])

    def part(self, kind: Callable[[], T]) -> T:
        """What `kind()` gave when this session first asked: the caches that other modules keep for it."""
        if kind not in self.parts:
            self.parts.setdefault(kind, kind())
        return self.parts[kind]  # type: ignore[no-any-return]

    def register(self, definition: NodeDef) -> None:
        """Add a type; one name stands for one function or class. Raises ValueError where it stands for another."""
        known = self.types.get(definition.type)
        again = known is not None and {known.function.__module__, definition.function.__module__} == {"__main__"}
        if known is not None and known.origin != definition.origin and not again:  # a cell that was written anew
            raise ValueError(f"the type {definition.type!r} is registered twice: {known.origin}, {definition.origin}")
        name = definition.type
        for old in (name, *definition.was):
            if self.renamed.get(old, name) != name or (old != name and old in self.types):
                raise ValueError(f"the type {name!r}: the name {old!r} is that of another type, or was")
        self.types[definition.type] = definition
        self.renamed.update(dict.fromkeys(definition.was, definition.type))

    def find(self, name: str) -> NodeDef | None:
        """The type of this name, also of one that it had before; None where there is none."""
        return self.types.get(self.renamed.get(name, name))

    def load(self) -> Self:
        """Import all packs. A broken module is noted, so that graphs without it still run."""
        self.broken = {}
        _named.update(self.names or ())
        for pack in self._pack_names():
            with self if self.names is None else Packs():  # named packs bring what is theirs, not what they import
                package = self._imported(pack)
                for info in pkgutil.iter_modules(getattr(package, "__path__", [])):
                    if not info.name.startswith("_"):
                        self._imported(f"{pack}.{info.name}")
            for home in [home for home in list(_declared) if _below(home, pack)]:  # by whomever it was imported
                with self._noting(home):
                    for definition in list(_declared[home].values()):
                        self.register(definition)
        self.types = dict(sorted(self.types.items()))
        return self

    def modules(self) -> list[str]:
        """The names from which another process makes the same session; types of `__main__` stay behind."""
        packs = self._pack_names()
        homes = {definition.function.__module__ for definition in self.types.values()} - {"__main__"}
        return [*packs, *sorted(home for home in homes if not any(_below(home, pack) for pack in packs))]

    def leaves_out(self, module: str) -> bool:
        """Whether a module belongs to a pack that only other sessions were made for."""
        own = [*(self.names or ()), *(definition.function.__module__ for definition in self.types.values())]
        return any(_below(module, pack) for pack in _named) and not any(_below(module, home) for home in own)

    def library_version(self, name: str) -> str:
        """The version of an installed distribution; MissingLibraryError when there is none."""
        if name not in self.versions:
            try:
                self.versions[name] = importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                raise MissingLibraryError(f"the library {name} is not installed", fix=f"pip install {name}") from None
        return self.versions[name]

    def _pack_names(self) -> list[str]:
        if self.names is not None:
            return list(self.names)
        entries = importlib.metadata.entry_points(group=GROUP)
        return [entry.module for entry in sorted(entries, key=lambda e: (e.value, e.name))]

    def _imported(self, name: str) -> ModuleType | None:
        with self._noting(name):
            return importlib.import_module(name)
        return None

    @contextlib.contextmanager
    def _noting(self, module: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self.broken.setdefault(module, _said(error))


DEFAULT = Packs()
_stack: contextvars.ContextVar[tuple[Packs, ...]] = contextvars.ContextVar("packs", default=(DEFAULT,))


def current() -> Packs:
    """What the session of this thread knows."""
    return _stack.get()[-1]


def load_packs() -> Packs:
    """The packs of the current session, loaded."""
    return current().load()


def declare(definition: NodeDef) -> None:
    """Note what a module declares, and register it in the current session."""
    current().register(definition)
    _declared.setdefault(definition.function.__module__, {})[definition.type] = definition


def _below(module: str, pack: str) -> bool:
    return module == pack or module.startswith(pack + ".")


def _said(error: Exception) -> str:
    """The error with the last place outside this package and Python's own import machinery."""
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__}: {error}"  # says the place itself
    frames = traceback.extract_tb(error.__traceback__)
    own = str(Path(__file__).parent)
    places = [f for f in frames if not f.filename.startswith((own, "<")) and f.filename != importlib.__file__]
    return f"{type(error).__name__}: {error}" + (f" ({places[-1].filename}:{places[-1].lineno})" if places else "")
