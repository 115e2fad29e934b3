"""Care of a store from Python and for the command line: verify, pins, gc; sizes and times as people write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ByteSize, TypeAdapter, ValidationError

from exmesh_graph.api.opening import Folder, open_store
from exmesh_graph.api.results import read_run
from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.graph.upkeep import collect, pins
from exmesh_graph.graph.upkeep.collect import verify as faults_of

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}


def existing(store: Folder = None) -> Store:
    """The store that is there already. Raises ExmeshError."""
    opened = open_store(store)
    if not opened.root.is_dir():
        raise ExmeshError("there is no store here", where=str(opened.root), fix="name its folder with --store")
    return opened


def verify(store: Folder = None) -> Iterator[tuple[str, str]]:
    """Read every byte of a store; yields (what, why) of each thing that was broken and went to quarantine."""
    return faults_of(existing(store))


def pin(what: str, name: str, *, store: Folder = None, runs: Folder = "runs") -> pins.Pin:
    """Keep the results of a run (its folder or id) or of one key, whatever `gc` removes."""
    opened = existing(store)
    key = key_of_prefix(opened, what)
    if key is not None:
        return pins.pin(opened, name, f"key {key[:12]}", [key])
    folder = Path(what) if (Path(what) / "run.json").is_file() else Path(runs or "runs") / what
    record = read_run(folder)
    return pins.pin(opened, name, "run " + record["id"], [row["key"] for row in record["nodes"] if row["key"]])


def key_of_prefix(store: Store, prefix: str) -> str | None:
    """The one key of a record that begins with `prefix`; None when there is none. Raises StoreError for several."""
    if not re.match(r"[0-9a-f]{6,64}\Z", prefix):
        return None
    keys = [path.stem for path in (store.root / "actions" / prefix[:2]).glob(f"{prefix}*.json")]
    if len(keys) > 1:
        raise StoreError(f"{prefix} begins {len(keys)} keys", fix="give more of it")
    return keys[0] if keys else None


def pinned(store: Folder = None) -> list[pins.Pin]:
    """All pins."""
    return pins.pins(existing(store))


def unpin(name: str, store: Folder = None) -> pins.Pin:
    """Remove a pin."""
    return pins.unpin(existing(store), name)


def gc(
    store: Store, *, runs: Iterable[Path] = (), age: str = "1h", budget: str | None = None, delete: bool = False
) -> tuple[list[collect.Item], collect.Survey]:
    """What no run and no pin needs, removed if `delete`; and the survey, which knows what stays."""
    survey = collect.survey(store, runs, to_seconds(age), None if budget is None else to_bytes(budget))
    gone = survey.items
    if delete:
        gone, spared = collect.delete(store, survey)
        survey.kept_bytes += sum(item.bytes for item in spared)
    return gone, survey


def to_bytes(text: str) -> int:
    """`5GB` -> 5000000000; kB, MB, GB, TB are decimal, KiB to TiB binary."""
    try:
        return TypeAdapter(ByteSize).validate_python(text.strip())
    except ValidationError:
        expected = "a number with B, kB, MB, GB, TB, MiB or GiB"
        raise ExmeshError(f"{text!r} is no size", expected=expected) from None


def to_seconds(text: str) -> float:
    """`30d` -> 2592000.0; s, min, h, d or w."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([a-z]+)\s*", text)
    if match is None or match[2] not in _SECONDS:
        raise ExmeshError(f"{text!r} is no span of time", expected="a number with s, min, h, d or w")
    return float(match[1]) * _SECONDS[match[2]]


def shown_bytes(size: int) -> str:
    """`12.3 MB`."""
    return ByteSize(size).human_readable(decimal=True, separator=" ").replace("K", "k")
