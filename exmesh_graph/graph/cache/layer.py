"""Running on a store that may only be read: a temporary store on top of it, which goes away with the run."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from exmesh_graph.graph.cache.store import Store


@contextlib.contextmanager
def writable(store: Store) -> Iterator[Store]:
    """The store itself, or where its folder may only be read, a temporary one that serves the hits of that store.

    What is computed then is used by the run, published and shared, but not kept; a note says so. Worker processes that
    open the temporary folder find the store below by the file `below` in it.
    """
    if not store.root.is_dir() or os.access(store.root, os.W_OK):
        yield store
        return
    with tempfile.TemporaryDirectory(prefix="exmesh-", ignore_cleanup_errors=True) as folder:
        Path(folder, "below").write_text(str(store.root), encoding="utf-8")
        for memo in (store.sources.path, store.code.path):
            with contextlib.suppress(OSError):
                shutil.copyfile(memo, Path(folder, memo.name))
        layer = Store(Path(folder), None if store.remote is None else store.remote.url)
        layer.notes.append(f"{store.root} may only be read: its hits are used, new results are not kept")
        yield layer
