"""A session: the node packs, caches and store that a caller works with. No two sessions of a process touch each other.

    session = Session(packs=["my_pack"])      # without `packs`: the installed ones
    graph = session.check("graph.yaml")
    with session:                             # `@node` in here declares a type of this session alone
        ...

The default session stands behind the decorators, the commands and the functions of `exmesh_graph`.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Self

from exmesh_graph.graph.cache.fingerprint import Sources
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs, current
from exmesh_graph.graph.language import check, yamlfile
from exmesh_graph.graph.sealed import Memo

if TYPE_CHECKING:
    from exmesh_graph.graph.declare.node import NodeDef
    from exmesh_graph.graph.variants.checked import CheckedVariant

Folder = str | os.PathLike[str] | None


class Session:
    """Packs by name (modules or packages of modules; None: the installed ones), and all that is known of them."""

    def __init__(self, packs: Iterable[str | ModuleType] | str | ModuleType | None = None) -> None:
        listed: Any = [packs] if isinstance(packs, str | ModuleType) else packs
        names = None if listed is None else [p.__name__ if isinstance(p, ModuleType) else p for p in listed]
        self._packs = Packs(names)
        self._packs.parts[Session] = self
        self._store: Store | None = None

    def __enter__(self) -> Self:
        """Make this session the current one of the thread."""
        self._packs.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._packs.__exit__()

    def packs(self) -> Packs:
        """Its packs, loaded: `types`, and `broken` ones with the reason. Edited source files are looked at again."""
        self._packs.part(Sources).refresh()
        return self._packs.load()

    @property
    def types(self) -> Mapping[str, NodeDef]:
        """{type: definition} of all node and component types."""
        return self.packs().types

    def check(
        self,
        graph: str | os.PathLike[str],
        overrides: Iterable[str] = (),
        variant: str | None = None,
        store: Folder = None,
        top: yamlfile.Map | None = None,
    ) -> check.Checked:
        """A graph file, or one of its variants, checked. Raises GraphErrors with all faults.

        `overrides` are texts as `--set` takes them; `top` is the merged mapping of a graph that is no file. Long files
        that were read with this store before are not parsed again.
        """
        packs, path = self.packs(), Path(graph)
        with self.reading(store):
            if variant:
                from exmesh_graph.graph.variants.checked import check_variant

                return check_variant(path, overrides, packs, variant, top=top)
            return check.check_file(path, overrides, packs, top)

    def check_variants(
        self, graph: str | os.PathLike[str], overrides: Iterable[str] = (), store: Folder = None, **options: Any
    ) -> list[CheckedVariant]:
        """A graph file and all variants that it declares, checked; `options` are those of `check_variants`."""
        from exmesh_graph.graph.variants.checked import check_variants

        packs = self.packs()
        with self.reading(store):
            return check_variants(Path(graph), overrides, packs, **options)

    def open_store(self, folder: Folder = None, shared: str | None = None) -> Store:
        """The store in `folder`, $EXMESH_STORE or ./.exmesh, before a tier that machines share ($EXMESH_SHARED)."""
        self._store = Store(store_folder(folder), shared or os.environ.get("EXMESH_SHARED"))
        return self._store

    @property
    def store(self) -> Store:
        """The store that was opened last, or the default one."""
        return self._store or self.open_store()

    @contextlib.contextmanager
    def reading(self, store: Folder) -> Iterator[None]:
        """Read graph files in this session, through the store's memory of parsed ones where there is a store."""
        root = store_folder(store)
        memo = Memo(root / "graphs.json", root / "work")
        self._packs.part(yamlfile.Reader).memo = memo if root.is_dir() else None
        with self:
            yield
        memo.save()


def current_session() -> Session:
    """The session of this thread: that of the innermost `with session:`, else the default one (installed packs)."""
    packs = current()
    if Session not in packs.parts:
        session = Session()
        session._packs = packs
        packs.parts.setdefault(Session, session)
    return packs.parts[Session]  # type: ignore[no-any-return]


def store_folder(given: Folder = None) -> Path:
    """`given`, $EXMESH_STORE or ./.exmesh."""
    return Path(given or os.environ.get("EXMESH_STORE") or ".exmesh").absolute()
