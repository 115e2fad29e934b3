"""`verify`: every byte of a store read and checked, and what it holds beside results: pins, checkpoints, leases."""

from __future__ import annotations

from collections.abc import Iterator

from exmesh_graph.errors import StoreError
from exmesh_graph.graph.cache.lease import Leases
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.checkpoint import checked_step
from exmesh_graph.graph.upkeep.pins import read_pin


def verify(store: Store) -> Iterator[tuple[str, str]]:
    """(what, why) of each fault. Broken objects, records and checkpoints are in quarantine afterwards."""
    yield from store.verify()
    for folder in sorted((store.root / "checkpoints").glob("*/*")):
        try:
            checked_step(folder, folder.parent.name)
        except Exception as error:
            store.quarantine(folder, str(error))
            yield f"checkpoint {folder.parent.name}/{folder.name}", store.notes[-1]
    for path in sorted((store.root / "pins").glob("*.json")):
        try:
            lost = [key for key in read_pin(path).keys if store.look_up(key, use=False) is None]
        except StoreError as error:
            yield f"pin {path.stem}", str(error)
        else:
            if lost:
                why = f"{len(lost)} of its results are gone, {lost[0]} first; run the graph again"
                yield f"pin {path.stem}", why
    for why in Leases(store.root).sweep():
        yield "lease", f"{why}; removed"
