"""What a run would do with each node, and why: hit, run, unknown below a node that must run first, or nothing (idle)
where something that the node needs turned out to be absent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in
from exmesh_graph.graph.cache.keys import NOTHING, Action, Stored, key_of, preimage_of
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.problems import in_short
from exmesh_graph.graph.run.lists import Outputs, fed, gathered, lacking, mapped, whole

HIT, RUN, UNKNOWN, IDLE = "hit", "run", "unknown", "idle"
Reasons = Callable[[Bound, Mapping[str, Any], Store], list[str]]
"""(a node, the pre-image of its key, a store) -> why it is no hit, in words (see `report.reasons`)"""


@dataclass(frozen=True)
class Step:
    """One node of a plan. `preimage` is None where it cannot be known yet."""

    name: str
    state: str
    reason: str
    key: str | None = None
    preimage: Mapping[str, Any] | None = None
    action: Action | None = None


def plan(graph: Checked, store: Store, targets: set[str] | None = None, reasons: Reasons | None = None) -> list[Step]:
    """The steps of a run, in order. Nothing is computed; below a node that must run, keys are unknown."""
    with graph.packs:
        steps = _steps(graph, store, targets, reasons)
    store.save()
    return steps


def _steps(graph: Checked, store: Store, targets: set[str] | None, reasons: Reasons | None) -> list[Step]:
    steps: list[Step] = []
    outputs: dict[str, Mapping[str, Stored]] = {}
    for name, bound in graph.nodes.items():
        if targets is not None and name not in targets:
            continue
        waits = sorted({link.node for link in bound.inputs.values() if link.node not in outputs})
        if waits:
            steps.append(Step(name, UNKNOWN, f"waits for {', '.join(waits)}"))
            continue
        if wire := lacking(bound, outputs):
            steps.append(Step(name, IDLE, f"not needed: {wire} carries nothing"))
            outputs[name] = dict.fromkeys(bound.signature.outputs, NOTHING)
            continue
        try:
            nodes = mapped(bound, outputs) if bound.each else [bound]
            made = [_step(node, store, outputs, reasons) for node in nodes]
        except ExmeshError as error:
            steps.append(Step(name, UNKNOWN, error.what))
            continue
        steps += made
        missing = [step.name for step in made if step.action is None]
        if not missing:
            known = [step.action.outputs for step in made if step.action is not None]
            outputs[name] = gathered(bound, known) if bound.each else known[0]
        if bound.each:
            words = f"waits for {in_short(missing, 3)}" if missing else f"gathers {len(made)}"
            steps.append(Step(name, UNKNOWN if missing else HIT, words))
    return steps


def _step(bound: Bound, store: Store, outputs: Outputs, reasons: Reasons | None) -> Step:
    preimage = preimage_for(bound, store, outputs)
    key = key_of(preimage)
    action = store.find(preimage, key, fetch=False)
    if action is not None and whole(action.outputs, bound.signature):
        far = store.remote is not None and store.look_up(key) is None
        return Step(bound.name, HIT, "in the shared store" if far else "", key, preimage, action)
    words = reasons(bound, preimage, store) if reasons else []
    return Step(bound.name, RUN, "; ".join([*words[:3], *(["..."] if words[3:] else [])]), key, preimage)


def preimage_for(bound: Bound, store: Store, outputs: Outputs) -> dict[str, Any]:
    """The pre-image of a node's key, given the recorded outputs of the nodes before it."""
    given = fed(bound, outputs).items()
    inputs = {port: (stored.type, stored.digest) for port, (_, stored) in given if stored != NOTHING}
    remember_in(store.code)
    try:
        sources = {name: store.sources.digest(path) for name, path in bound.sources.items()}
    except OSError as error:
        what = f"{bound.name}: a source file cannot be read: {error.strerror}"
        raise GraphError(what, where=str(error.filename), fix="it was there when the graph was checked") from error
    return preimage_of(bound, fingerprint(bound.definition).digest, sources, inputs)
