"""Code changes that were accepted: results of the old code count as results of the new.

    accepted/<id>.json   sealed {type, new, old, parts, who, when}: for this type, `new` may use what `old` made

It holds for a node type or a component type, in one direction, and along chains (B took A's results, C takes B's).
Nothing but code may differ. What the new code computes is recorded under its own key, so that revoking an acceptance
leaves no trace.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exmesh_graph.graph import files
from exmesh_graph.graph.cache.keys import digest_of
from exmesh_graph.graph.cache.store import Store

MOST = 256  # pre-images to look up for one miss


@dataclass(frozen=True)
class Accepted:
    """An accepted change: results that `old` code made count for `new`. `parts` are the modules that changed."""

    id: str
    type: str
    new: str
    old: str
    parts: tuple[str, ...]
    who: str
    when: float

    def __str__(self) -> str:
        day = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.when))
        return f"{self.id}  {self.type}  {', '.join(self.parts)}  ({self.who}, {day})"


def accepted(store: Store) -> list[Accepted]:
    """All accepted changes, the oldest first; one that is not as it was written goes to quarantine."""
    found = [read_accepted(store, path) for path in sorted((store.root / "accepted").glob("*.json"))]
    return sorted((entry for entry in found if entry is not None), key=lambda entry: entry.when)


def read_accepted(store: Store, path: Path) -> Accepted | None:
    """The accepted change in a file, None (and quarantine) when it is not sound."""
    try:
        raw = files.read_sealed(path)
        entry = Accepted(path.stem, raw["type"], raw["new"], raw["old"], tuple(raw["parts"]), raw["who"], raw["when"])
        if accepted_id(entry.type, entry.new, entry.old) != path.stem:
            raise ValueError("its name does not belong to its contents")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        store.quarantine(path, str(error))
        return None
    return entry


def accepted_id(node_type: str, new: str, old: str) -> str:
    """The name of the record of a change."""
    return digest_of([node_type, new, old])[:12]


def equivalents(store: Store, preimage: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The pre-images that count as this one: older code in the node and in its components, nothing else."""
    table: dict[tuple[str, str], list[Accepted]] = {}
    for entry in accepted(store):
        table.setdefault((entry.type, entry.new), []).append(entry)
    places = codes(preimage)
    choices = [_older(table, node_type, code) for _, node_type, code in places]
    for chosen in itertools.islice(itertools.product(*choices), 1, MOST):
        yield _with_codes(preimage, {place: code for (place, _, _), code in zip(places, chosen, strict=True)})


def accepted_between(store: Store, preimage: Mapping[str, Any], old: Mapping[str, Any]) -> list[Accepted]:
    """The accepted changes that lead from a record's pre-image to this one."""
    entries = accepted(store)
    before = {place: code for place, _, code in codes(old)}
    return [
        entry
        for place, node_type, code in codes(preimage)
        for entry in _chain([e for e in entries if e.type == node_type], code, before.get(place, code))
    ]


def codes(preimage: Mapping[str, Any], place: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], str, str]]:
    """(place, type, code fingerprint) of a node and of the components plugged into it."""
    found = [(place, str(preimage["type"]), str(preimage["code"]))]
    for port, plug in sorted(preimage.get("components", {}).items()):
        found += codes(plug, (*place, port))
    return found


def without_codes(preimage: Mapping[str, Any]) -> dict[str, Any]:
    """The pre-image with all code fingerprints blotted out."""
    return _with_codes(preimage, {})


def _with_codes(
    preimage: Mapping[str, Any], given: Mapping[tuple[str, ...], str], place: tuple[str, ...] = ()
) -> dict[str, Any]:
    changed = {**preimage, "code": given.get(place, "")}
    if "components" in preimage:
        plugs = preimage["components"].items()
        changed["components"] = {port: _with_codes(plug, given, (*place, port)) for port, plug in plugs}
    return changed


def _older(table: Mapping[tuple[str, str], list[Accepted]], node_type: str, code: str) -> list[str]:
    """The fingerprint itself and those accepted for it, step by step."""
    found = [code]
    for new in found:
        found += [entry.old for entry in table.get((node_type, new), []) if entry.old not in found]
    return found


def _chain(entries: list[Accepted], new: str, old: str) -> list[Accepted]:
    """The shortest chain of changes from `old` to `new`; empty when they are the same or there is none."""
    chains: list[list[Accepted]] = [[]]
    while chains:
        chain = chains.pop(0)
        last = chain[-1].old if chain else new
        if last == old:
            return chain
        chains += [[*chain, entry] for entry in entries if entry.new == last and entry not in chain]
    return []
