"""Pins: results that `gc` never removes, by name.

pins/<name>.json   sealed {name, of, keys, who, when}
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exmesh_graph import files
from exmesh_graph.errors import StoreError
from exmesh_graph.graph import sealed
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.resources import user_and_host

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}\Z")


@dataclass(frozen=True)
class Pin:
    """A name for records that stay: all of a run, or one key. `of` says what was pinned."""

    name: str
    of: str
    keys: tuple[str, ...]
    who: str
    when: float

    def __str__(self) -> str:
        day = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.when))
        return f"{self.name}  {self.of}, {len(self.keys)} results  ({self.who}, {day})"


def pin(store: Store, name: str, of: str, keys: Iterable[str]) -> Pin:
    """Pin the results of `keys`, those of them that the store holds. Raises StoreError for a bad or used name."""
    if not _NAME.match(name):
        raise StoreError(f"{name!r} cannot name a pin", expected="letters, digits, '.', '_' and '-'")
    if _path(store, name).exists():
        raise StoreError(f"there is a pin {name!r} already", fix=f"exmesh unpin {name}, or take another name")
    present = tuple(sorted({key for key in keys if store.look_up(key) is not None}))
    if not present:
        raise StoreError(f"{of} has no results in this store", where=str(store.root))
    entry = Pin(name, of, present, user_and_host(), time.time())
    with files.writing("the store", store.root, "--store"):
        files.write_durably(_path(store, name), sealed.seal_text({**vars(entry), "keys": list(present)}), store.work)
    return entry


def unpin(store: Store, name: str) -> Pin:
    """Remove a pin; its results stay until `gc` finds nothing else that needs them."""
    known = {entry.name: entry for entry in pins(store)}
    if name not in known:
        raise StoreError(f"there is no pin {name!r}", expected=", ".join(known) or "no pins at all")
    with files.writing("the store", store.root, "--store"):
        _path(store, name).unlink()
    return known[name]


def pins(store: Store) -> list[Pin]:
    """All pins. Raises StoreError for one that cannot be read: what it protects is then not known."""
    entries = []
    for path in sorted((store.root / "pins").glob("*.json")):
        try:
            entries.append(read_pin(path))
        except StoreError:
            if path.exists():  # else it was unpinned since it was listed
                raise
    return entries


def read_pin(path: Path) -> Pin:
    """A pin's file. Raises StoreError when it is not as it was written."""
    try:
        raw: dict[str, Any] = sealed.read_sealed(path)
        entry = Pin(raw["name"], raw["of"], tuple(raw["keys"]), raw["who"], raw["when"])
        if entry.name != path.stem:
            raise ValueError(f"it says that its name is {entry.name}")
        return entry
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"the pin {path.stem} cannot be read: {error}"
        raise StoreError(what, where=str(path), fix="remove it and pin again") from error


def _path(store: Store, name: str) -> Path:
    return store.root / "pins" / f"{name}.json"
