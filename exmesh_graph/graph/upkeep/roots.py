"""What keeps results in a store: the runs that show them, pins, leases, and work in progress.

roots/<id>   sealed {host, path}: a folder of runs that used this store, noted by the run itself
"""

from __future__ import annotations

import contextlib
import json
import platform
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from exmesh_graph.errors import StoreError
from exmesh_graph.graph.cache.lease import Leases
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.upkeep.pins import pins


@dataclass
class Roots:
    """Keys that stay, by what holds them; `notes` is what the user should know before anything goes."""

    pinned: set[str] = field(default_factory=set)
    shown: set[str] = field(default_factory=set)
    leased: set[str] = field(default_factory=set)
    runs: int = 0
    notes: list[str] = field(default_factory=list)


def find_roots(store: Store, runs: Iterable[Path]) -> Roots:
    """The roots of a store. Raises StoreError when a pin or a run of a known folder cannot be read."""
    roots = Roots()
    for entry in pins(store):
        roots.pinned.update(entry.keys)
    roots.leased.update(Leases(store.root).holders())
    folders = {path.resolve() for path in runs}
    here = platform.node()
    for note in sorted((store.root / "roots").glob("*")):
        told = store.folder_of_runs(note)
        if told is None:
            what = store.notes[-1] if store.notes else f"{note} was moved away while it was read"
            raise StoreError(what, fix="name the folders of runs that are needed with --runs and go on")
        host, path = told
        if path.is_dir():
            folders.add(path.resolve())
        elif host != here:
            roots.notes.append(f"the runs in {path} of {host} cannot be seen from here: their results count as unused")
    for folder in sorted(folders):
        for run in _runs(folder):
            keys = _keys(run)
            if keys is not None:
                roots.runs += 1
                roots.shown.update(keys)
    return roots


def _runs(folder: Path) -> list[Path]:
    with contextlib.suppress(FileNotFoundError):  # the folder may be removed while it is listed
        return sorted(run for run in folder.glob("*/run.json") if not run.parent.is_symlink())
    return []


def _keys(run: Path) -> set[str] | None:
    """What a run shows; None when it was removed since it was listed: it needs nothing any more."""
    try:
        rows = json.loads(run.read_text(encoding="utf-8"))["nodes"]
        return {row["key"] for row in rows if row.get("key")}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"a run cannot be read ({type(error).__name__}), so that what it needs is not known"
        raise StoreError(what, where=str(run), fix="remove that run's folder if it is of no use") from error
