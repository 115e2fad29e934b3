"""`gc`: what a store holds that nothing needs any more.

A record stays when a run shows it, a pin names it, its key is leased, or it was made or used a short while ago. An
object stays as long as a record that stays refers to it, or when it is new. With a budget, the records used longest ago
go first, those of runs included; never pinned, leased or new ones.

Deleting is safe beside runs: records go before objects; everything is renamed into `trash/` first; what was used or
needed since the survey is put back, and only then is the trash removed.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from exmesh_graph.graph import files
from exmesh_graph.graph.cache.lease import Leases
from exmesh_graph.graph.cache.records import NOTHING
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.upkeep.roots import Roots, find_roots

HOUR, DAY = 3600.0, 86400.0
CHECKPOINT_AGE, QUARANTINE_AGE = 30 * DAY, 7 * DAY
SETTLE = 0.2  # seconds for a look-up under way to note its use


@dataclass
class Item:
    """A file or folder that may go: its bytes, the time of its last use, the objects it refers to, and why it goes."""

    kind: str
    name: str
    path: Path
    bytes: int
    used: float
    objects: tuple[str, ...] = ()
    why: str = ""


@dataclass
class Survey:
    """What may go (`items`) and what stays, in bytes."""

    roots: Roots
    items: list[Item] = field(default_factory=list)
    kept: Counter[str] = field(default_factory=Counter)
    kept_bytes: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        return sum(item.bytes for item in self.items)


def survey(store: Store, runs: Iterable[Path] = (), age: float = HOUR, budget: int | None = None) -> Survey:
    """Look through the store; nothing is changed but that doubtful records go to quarantine.

    runs: folders of runs beside those that noted themselves in the store. age: seconds for which what was used stays.
    Raises StoreError when a pin or a run cannot be read.
    """
    roots = find_roots(store, runs)
    found = Survey(roots, notes=list(roots.notes))
    recent = min([_now(store) - age, *_starts_of_work(store)])
    records, objects = list(_records(store)), {item.name: item for item in _objects(store)}
    kept = [item for item in records if _stays(item, roots, recent)]
    going = [item for item in records if not _stays(item, roots, recent)]
    for item in going:
        item.why = "no run or pin shows it"
    others = [*_checkpoints(store, roots, age), *_quarantine(store), *_drafts(store)]
    needed = Counter(digest for item in kept for digest in item.objects)
    size = sum(item.bytes for item in kept) + sum(i.bytes for d, i in objects.items() if d in needed or i.used > recent)
    if budget is not None:
        for item in sorted(kept, key=lambda item: item.used):
            if size <= budget:
                break
            if item.name in roots.pinned or item.name in roots.busy or item.used > recent:
                continue
            item.why = "the store is over its budget, and this was used longest ago"
            going.append(item)
            kept.remove(item)
            size -= item.bytes
            needed.subtract(item.objects)
            size -= sum(objects[d].bytes for d in set(item.objects) if d in objects and not needed[d])
        if size > budget:
            found.notes.append("what is pinned, in use or new is more than the budget")
    loose = [item for digest, item in objects.items() if not needed[digest] and item.used <= recent]
    for item in loose:
        item.why = "no record that stays refers to it"
    found.items = [*going, *loose, *others]
    found.kept = Counter(result=len(kept), object=len(objects) - len(loose))
    found.kept_bytes = size
    return found


def delete(store: Store, found: Survey) -> tuple[list[Item], list[Item]]:
    """Remove what a survey found; returns (removed, left or put back since it is in use again)."""
    files.sweep_abandoned(store.root / "trash")
    Leases(store.root).sweep()
    removed: list[tuple[Item, Path]] = []
    spared: list[Item] = []
    with files.writing("the store", store.root, "--store"), files.own_folder(store.root / "trash") as trash:
        for number, item in enumerate(found.items):
            aside = trash / str(number)
            if _used(item.path) == item.used and _rename(item.path, aside):
                removed.append((item, aside))
            else:
                spared.append(item)
        time.sleep(SETTLE)
        records = [pair for pair in removed if pair[0].kind == "result"]
        back = _needed_again(store, records)
        for item, aside in removed:
            used = item.kind in ("result", "object") and _used(aside) != item.used
            if (used or item.path in back) and _rename(aside, item.path):
                spared.append(item)
    gone = {item.path for item in spared}
    return [item for item, _ in removed if item.path not in gone], spared


def _needed_again(store: Store, records: list[tuple[Item, Path]]) -> set[Path]:
    """The paths of trashed records that were used since, and of all objects that these and the others refer to."""
    held = {holder.key for holder in Leases(store.root).holders()}
    again = [item for item, aside in records if _used(aside) != item.used or item.name in held]
    digests = {digest for item in (*again, *_records(store)) for digest in item.objects}
    return {item.path for item in again} | {store.data(digest).parent for digest in digests}


def _stays(item: Item, roots: Roots, recent: float) -> bool:
    return item.name in roots.pinned or item.name in roots.shown or item.name in roots.busy or item.used > recent


def _records(store: Store) -> Iterator[Item]:
    for path in sorted((store.root / "actions").glob("*/*.json")):
        with contextlib.suppress(OSError):
            status = path.stat()
            action = store.read(path)
            if action is not None:
                digests = tuple(s.digest for s in action.outputs.values() if s.digest != NOTHING.digest)
                yield Item("result", path.stem, path, status.st_size, status.st_mtime, digests)


def _objects(store: Store) -> Iterator[Item]:
    for path in sorted((store.root / "objects").glob("*/*")):
        with contextlib.suppress(OSError):
            yield Item("object", path.name, path, sum(files.sizes(path).values()), path.stat().st_mtime)


def _checkpoints(store: Store, roots: Roots, age: float) -> Iterator[Item]:
    now = _now(store)
    for path in sorted((store.root / "checkpoints").glob("*")):
        with contextlib.suppress(OSError):
            item = Item("checkpoint", path.name, path, sum(files.sizes(path).values()), path.stat().st_mtime)
            if path.name in roots.busy:
                continue
            if store.look_up(path.name, use=False) is not None:
                item.why = "its result is recorded"
            elif now - item.used > max(age, CHECKPOINT_AGE):
                item.why = f"older than {max(age, CHECKPOINT_AGE) / DAY:.0f} days"
            if item.why:
                yield item


def _quarantine(store: Store) -> Iterator[Item]:
    for path in sorted((store.root / "quarantine").glob("*")):
        with contextlib.suppress(OSError):
            since = path.suffix[1:]
            if since.isdigit() and time.time() - int(since) / 1e9 > QUARANTINE_AGE:
                size = sum(files.sizes(path).values()) if path.is_dir() else path.stat().st_size
                why = f"in quarantine for more than {QUARANTINE_AGE / DAY:.0f} days"
                yield Item("quarantine", path.name, path, size, path.stat().st_mtime, why=why)


def _drafts(store: Store) -> Iterator[Item]:
    """What machines that died left half-sent in a shared store."""
    for path in sorted((store.root / "drafts").glob("*")):
        with contextlib.suppress(OSError):
            status = path.stat()
            if time.time() - status.st_mtime > DAY:
                yield Item("draft", path.name, path, status.st_size, status.st_mtime, why="half-sent a day ago")


def _starts_of_work(store: Store) -> Iterator[float]:
    """When the attempts under way began: what is newer may be theirs, however long they take."""
    for lock in store.work.glob("*/lock"):
        with contextlib.suppress(OSError):
            if files.is_locked(lock):
                yield lock.stat().st_mtime


def _now(store: Store) -> float:
    """The time by the clock of the store's file system, which may be another machine's."""
    with contextlib.suppress(OSError), files.own_folder(store.work) as folder:
        return folder.stat().st_mtime
    return time.time()


def _used(path: Path) -> float | None:
    try:
        return path.stat().st_mtime
    except OSError:
        return None


def _rename(path: Path, target: Path) -> bool:
    try:
        if target.exists():
            return False
        os.rename(path, target)
    except OSError:
        return False
    return True
