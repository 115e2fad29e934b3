"""`gc`: what a store holds that nothing needs any more; `verify`: every byte of it read and checked.

A record stays when a run shows it, a pin names it, its key is leased, or it was made or used a short while ago. Each
run noted its folder of runs in the store: roots/<id>, sealed {host, path}. An object stays as long as a record that
stays refers to it, or when it is new. With a budget, the records used longest ago go first, those of runs included;
never pinned, leased or new ones.

Deleting is safe beside runs: records go before objects; everything is renamed into `trash/` first; what was used or
needed since the survey is put back, and only then is the trash removed.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import subprocess
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from exmesh_graph import files
from exmesh_graph.errors import StoreError
from exmesh_graph.graph.cache.lease import Leases
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.checkpoint import checked_step
from exmesh_graph.graph.upkeep.pins import pins, read_pin

HOUR, DAY = 3600.0, 86400.0
CHECKPOINT_AGE, QUARANTINE_AGE = 30 * DAY, 7 * DAY
PATIENCE = 1.0  # seconds to wait until what was removed is off the disk
SETTLE = 0.2  # seconds for a look-up under way to note its use


@dataclass(frozen=True)
class Item:
    """A file or folder that may go: bytes on the disk, time of its last use, the objects it refers to, why it goes."""

    kind: str
    name: str
    path: Path
    bytes: int
    used: float
    objects: tuple[str, ...] = ()
    why: str = ""


@dataclass
class Survey:
    """What may go (`items`) and what stays, in bytes; how many runs and pinned results need it; what to know before."""

    items: list[Item] = field(default_factory=list)
    kept: Counter[str] = field(default_factory=Counter)
    kept_bytes: int = 0
    runs: int = 0
    pinned: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        return sum(item.bytes for item in self.items)


def survey(store: Store, runs: Iterable[Path] = (), age: float = HOUR, budget: int | None = None) -> Survey:
    """Look through the store; nothing is changed but that doubtful records go to quarantine.

    runs: folders of runs beside those that noted themselves in the store. age: seconds for which what was used stays.
    Raises StoreError when a pin or a run cannot be read.
    """
    pinned, leased = {key for entry in pins(store) for key in entry.keys}, set(Leases(store.root).holders())
    result = Survey(pinned=len(pinned))
    fixed = pinned | leased
    held = fixed | _shown(store, runs, result)
    recent = min([_now(store) - age, *_starts_of_work(store)])
    objects = {item.name: item for item in _items(store, "object", "objects/*/*")}
    kept: list[Item] = []
    going: list[Item] = []
    for item in _records(store):
        if item.name in held or item.used > recent:
            kept.append(item)
        else:
            going.append(replace(item, why="no run or pin shows it"))
    others = [*_checkpoints(store, leased, age), *_quarantine(store), *_drafts(store)]
    needed = Counter(digest for item in kept for digest in item.objects)
    size = sum(item.bytes for item in kept) + sum(i.bytes for d, i in objects.items() if d in needed or i.used > recent)
    if budget is not None:
        for item in sorted(kept, key=lambda item: item.used):
            if size <= budget:
                break
            if item.name in fixed or item.used > recent:
                continue
            going.append(replace(item, why="the store is over its budget, and this was used longest ago"))
            kept.remove(item)
            size -= item.bytes
            needed.subtract(item.objects)
            size -= sum(objects[d].bytes for d in item.objects if d in objects and not needed[d])
        if size > budget:
            result.notes.append("what is pinned, in use or new is more than the budget")
    loose = [
        replace(item, why="no record that stays refers to it")
        for digest, item in objects.items()
        if not needed[digest] and item.used <= recent
    ]
    result.items = [*going, *loose, *others]
    result.kept = Counter(result=len(kept), object=len(objects) - len(loose))
    result.kept_bytes = size
    return result


def _shown(store: Store, runs: Iterable[Path], survey: Survey) -> set[str]:
    """The keys that runs show, in `runs` and in all folders that noted themselves; those out of sight are told."""
    folders = {path.resolve() for path in runs}
    for note in sorted((store.root / "roots").glob("*")):
        told = store.folder_of_runs(note)
        if told is None:
            what = store.notes[-1] if store.notes else f"{note} was moved away while it was read"
            raise StoreError(what, fix="name the folders of runs that are needed with --runs and go on")
        host, path = told
        if path.is_dir():
            folders.add(path.resolve())
        elif host != platform.node():
            survey.notes.append(f"the runs in {path} of {host} cannot be seen from here: their results count as unused")
    listed: list[Path] = []
    for folder in sorted(folders):
        with contextlib.suppress(FileNotFoundError):  # it may be removed while it is listed
            listed += sorted(run for run in folder.glob("*/run.json") if not run.parent.is_symlink())
    keys: set[str] = set()
    for run in listed:
        try:
            rows = json.loads(run.read_text(encoding="utf-8"))["nodes"]
            keys |= {row["key"] for row in rows if row.get("key")}
        except FileNotFoundError:
            continue  # removed since it was listed: it needs nothing any more
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            what = f"a run cannot be read ({type(error).__name__}), so that what it needs is not known"
            raise StoreError(what, where=str(run), fix="remove that run's folder if it is of no use") from error
        survey.runs += 1
    return keys


def delete(store: Store, survey: Survey) -> tuple[list[Item], list[Item]]:
    """Remove what a survey lists; returns (removed, left or put back since it is in use again).

    All of it is out of the store then. Taking it off the disk, which waits for each folder, is left to a process of
    its own where it takes long; a note says so, and what such a process leaves, the next `delete` removes.
    """
    files.sweep_abandoned(store.root / "trash")
    Leases(store.root).sweep()
    removed: list[tuple[Item, str]] = []
    spared: list[Item] = []
    with files.writing("the store", store.root, "--store"), files.own_folder(store.root / "trash") as trash:
        for number, item in enumerate(survey.items):
            aside = f"{trash}/{number}"
            if _used(item.path) == item.used and _rename(item.path, aside):
                removed.append((item, aside))
            else:
                spared.append(item)
        time.sleep(SETTLE)
        back = _needed_again(store, [pair for pair in removed if pair[0].kind == "result"])
        for item, aside in removed:
            used = item.kind in ("result", "object") and _used(aside) != item.used
            if (used or item.path in back) and _rename(aside, item.path):
                spared.append(item)
        gone = trash.with_name(f"gone-{time.time_ns()}")
        os.rename(trash, gone)
        sweeper = subprocess.Popen(["rm", "-rf", str(gone)], start_new_session=True, stderr=subprocess.DEVNULL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            sweeper.wait(PATIENCE)
        if sweeper.returncode is None:
            survey.notes.append(f"the process {sweeper.pid} is still taking what was removed off the disk")
    stayed = {item.path for item in spared}
    return [item for item, _ in removed if item.path not in stayed], spared


def _needed_again(store: Store, records: list[tuple[Item, str]]) -> set[Path]:
    """The paths of trashed records that were used since, and of all objects that these and the others refer to."""
    held = set(Leases(store.root).holders())
    again = [item for item, aside in records if _used(aside) != item.used or item.name in held]
    digests = {digest for item in (*again, *_records(store)) for digest in item.objects}
    return {item.path for item in again} | {store.data(digest).parent for digest in digests}


def _items(store: Store, kind: str, pattern: str) -> Iterator[Item]:
    """What lies in the store under a pattern; what goes away meanwhile is left out."""
    for path in sorted(store.root.glob(pattern), key=str):  # paths compare slowly
        with contextlib.suppress(OSError):
            status = path.stat()
            yield Item(kind, path.name.removesuffix(".json"), path, files.allocated(path, status), status.st_mtime)


def _records(store: Store) -> Iterator[Item]:
    for item in _items(store, "result", "actions/*/*.json"):
        action = store.read(item.path)
        if action is not None:
            yield replace(item, objects=action.digests)


def _checkpoints(store: Store, leased: set[str], age: float) -> Iterator[Item]:
    now, oldest = _now(store), max(age, CHECKPOINT_AGE)
    for item in _items(store, "checkpoint", "checkpoints/*"):
        if item.name in leased:
            continue
        if store.look_up(item.name, use=False) is not None:
            yield replace(item, why="its result is recorded")
        elif now - item.used > oldest:
            yield replace(item, why=f"older than {oldest / DAY:.0f} days")


def _quarantine(store: Store) -> Iterator[Item]:
    for item in _items(store, "quarantine", "quarantine/*"):
        since = item.path.suffix[1:]
        if since.isdigit() and time.time() - int(since) / 1e9 > QUARANTINE_AGE:
            yield replace(item, why=f"in quarantine for more than {QUARANTINE_AGE / DAY:.0f} days")


def _drafts(store: Store) -> Iterator[Item]:
    """What machines that died left half-sent in a shared store."""
    for item in _items(store, "draft", "drafts/*"):
        if time.time() - item.used > DAY:
            yield replace(item, why="half-sent a day ago")


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


def _used(path: Path | str) -> float | None:
    with contextlib.suppress(OSError):
        return os.stat(path).st_mtime
    return None


def _rename(path: Path | str, target: Path | str) -> bool:
    with contextlib.suppress(OSError):
        if not os.path.lexists(target):
            os.rename(path, target)
            return True
    return False


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
                yield f"pin {path.stem}", f"{len(lost)} of its results are gone, {lost[0]} first; run the graph again"
    for why in Leases(store.root).sweep():
        yield "lease", f"{why}; removed"
