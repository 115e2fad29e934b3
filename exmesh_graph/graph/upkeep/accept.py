"""`accept`: find the nodes that only a change of code keeps from being hits, and accept that change; take it back."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

from exmesh_graph.errors import StoreError
from exmesh_graph.graph import files
from exmesh_graph.graph.cache.accepted import Accepted, accepted, accepted_id, codes, without_codes
from exmesh_graph.graph.cache.store import Action, Store
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.machine import user_and_host
from exmesh_graph.graph.run.plan import HIT, UNKNOWN, plan
from exmesh_graph.graph.run.why import changed_code, explain


def accept(graph: Checked, store: Store, only: set[str] | None = None) -> Iterator[tuple[str, str]]:
    """Accept what keeps the nodes of a graph (or `only` those) from being hits, where that is code alone.

    Yields (node, what was done). Works from the top of the graph down, since an accepted node makes known what its
    followers are keyed by.
    """
    told: set[str] = set()
    while True:
        for step in plan(graph, store, reasons=False):
            if step.state == HIT or step.name in told or not (only is None or step.name in only):
                continue
            told.add(step.name)
            if step.state == UNKNOWN or step.preimage is None:
                yield step.name, f"not accepted: it {step.reason}"
                continue
            twin = _twin(step.preimage, store)
            if twin is None:
                yield step.name, "not accepted: " + "; ".join(explain(graph.nodes[step.name], step.preimage, store)[:3])
                continue
            for entry in _write(store, graph.nodes[step.name], step.preimage, twin):
                yield step.name, f"accepted: {entry}"
            break
        else:
            return


def revoke(store: Store, id: str) -> Accepted:
    """Take back an accepted change, named by the first signs of its id. Raises StoreError when no one is meant."""
    found = [entry for entry in accepted(store) if entry.id.startswith(id)]
    if len(found) != 1 or not id:
        known = ", ".join(entry.id for entry in accepted(store)) or "none"
        raise StoreError(f"{id!r} names {len(found)} accepted changes", expected=f"one of {known}")
    with files.writing("the store", store.root, "--store"):
        (store.root / "accepted" / f"{found[0].id}.json").unlink()
    return found[0]


def _twin(preimage: Mapping[str, Any], store: Store) -> Action | None:
    """The latest record that differs in code alone."""
    blank = without_codes(preimage)
    for action in store.actions(preimage["type"]):
        if without_codes(action.preimage) == blank and store.look_up(action.key) is not None:
            return action
    return None


def _write(store: Store, bound: Bound, preimage: Mapping[str, Any], twin: Action) -> Iterator[Accepted]:
    for (place, kind, new), (_, _, old) in zip(codes(preimage), codes(twin.preimage), strict=True):
        if new == old:
            continue
        id, parts = (
            accepted_id(kind, new, old),
            [f"component {'.'.join(place)}"] if place else changed_code(twin, bound),
        )
        raw: dict[str, Any] = {
            "type": kind,
            "new": new,
            "old": old,
            "parts": parts,
            "who": user_and_host(),
            "when": time.time(),
        }
        with files.writing("the store", store.root, "--store"):
            files.write_durably(store.root / "accepted" / f"{id}.json", files.seal_text(raw), store.work)
        yield Accepted(id, kind, new, old, tuple(parts), raw["who"], raw["when"])
