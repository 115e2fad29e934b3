"""What a run of the open graph would do, with the seconds that earlier records lead one to expect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.problems import without_rounds
from exmesh_graph.graph.run.plan import HIT, IDLE, RUN, UNKNOWN, Step
from exmesh_graph.report.reasons import explained as steps_of

_ORDER = (RUN, UNKNOWN, HIT, IDLE)  # what a folded node is called by


def plan_facts(checked: Checked, store: Store, targets: set[str] | None = None) -> dict[str, Any]:
    """PLAN of the contract; rounds are folded, and each stands in its node's `rounds`."""
    steps = steps_of(checked, store, targets)
    expected = Expected(store)
    counts = dict.fromkeys((HIT, RUN, UNKNOWN), 0)
    nodes: dict[str, dict[str, Any]] = {}
    total, complete = 0.0, True
    for step in steps:
        counts[step.state] = counts.get(step.state, 0) + 1
        seconds = _spent(step) if step.state == HIT else expected.of(step.name, checked.node(step.name).definition.type)
        seconds = None if step.state == IDLE else seconds
        if step.state not in (HIT, IDLE):
            total += seconds or 0.0
            complete = complete and seconds is not None
        row: dict[str, Any] = {
            "name": step.name,
            "state": step.state,
            "reason": step.reason,
            "seconds": seconds,
            "key": step.key,
        }
        if step.action is not None:
            row["outputs"] = {port: asdict(stored) for port, stored in step.action.outputs.items()}
        nodes.setdefault(without_rounds(step.name), {"rounds": []})["rounds"].append(row)
    for folded in nodes.values():
        rounds = folded["rounds"]
        first = min(rounds, key=lambda row: _ORDER.index(row["state"]))
        told = [row["seconds"] for row in rounds if row["state"] == first["state"]]
        known = all(seconds is not None for seconds in told)
        folded |= {"state": first["state"], "reason": first["reason"], "known": known,
                   "seconds": sum(seconds or 0.0 for seconds in told)}  # fmt: skip
    for name in checked.idle:
        row = {"name": name, "state": IDLE, "reason": "nothing needs it", "seconds": None, "key": None}
        folded = nodes.setdefault(without_rounds(name), {**row, "known": False, "rounds": []})
        folded["rounds"].append(row)
    return {"counts": counts, "idle": list(checked.idle), "seconds": total, "complete": complete, "nodes": nodes}


class Expected:
    """Seconds that nodes took when they ran last in a store: the same node, else another round of it."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self._known: dict[str, Mapping[str, float]] = {}

    def of(self, name: str, kind: str) -> float | None:
        """Seconds of one node; None where the store has no record of it."""
        if kind not in self._known:
            seconds: dict[str, float] = {}
            for action in self.store.actions(kind):  # the newest first
                node = str(action.info.get("node", ""))
                spent = float(action.info.get("seconds", 0.0))
                seconds.setdefault(node, spent)
                seconds.setdefault(without_rounds(node), spent)
            self._known[kind] = seconds
        known = self._known[kind]
        return known.get(name, known.get(without_rounds(name)))


def _spent(step: Step) -> float | None:
    return None if step.action is None else float(step.action.info.get("seconds", 0.0))
