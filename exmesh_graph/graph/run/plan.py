"""What a run would do with each node, and why: hit, run, or unknown below a node that must run first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError
from exmesh_graph.graph.cache.fingerprint import fingerprint, remember_in
from exmesh_graph.graph.cache.keys import ABSENT, key_of, preimage_of
from exmesh_graph.graph.cache.records import Action, Stored
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.run.why import explain

HIT, RUN, UNKNOWN = "hit", "run", "unknown"


@dataclass(frozen=True)
class Step:
    """One node of a plan. `preimage` is None where it cannot be known yet."""

    name: str
    state: str
    reason: str
    key: str | None = None
    preimage: Mapping[str, Any] | None = None
    action: Action | None = None


def plan(graph: Checked, store: Store, targets: set[str] | None = None, reasons: bool = True) -> list[Step]:
    """The steps of a run, in order. Nothing is computed; below a node that must run, keys are unknown."""
    with graph.packs:
        steps = _steps(graph, store, targets, reasons)
    store.save()
    return steps


def _steps(graph: Checked, store: Store, targets: set[str] | None, reasons: bool) -> list[Step]:
    steps: list[Step] = []
    outputs: dict[str, Mapping[str, Stored]] = {}
    for name, bound in graph.nodes.items():
        if targets is not None and name not in targets:
            continue
        waits = sorted({link.node for link in bound.inputs.values() if link.node not in outputs})
        if waits:
            steps.append(Step(name, UNKNOWN, f"waits for {', '.join(waits)}"))
            continue
        try:
            preimage = preimage_for(bound, store, lambda node, port: outputs[node][port])
        except ExmeshError as error:
            steps.append(Step(name, UNKNOWN, error.what))
            continue
        key = key_of(preimage)
        action = store.find(preimage, key, fetch=False)
        if action is not None and set(action.outputs) == set(bound.signature.outputs):
            outputs[name] = action.outputs
            far = store.remote is not None and store.look_up(key) is None
            steps.append(Step(name, HIT, "in the shared store" if far else "", key, preimage, action))
        else:
            words = explain(bound, preimage, store) if reasons else []
            steps.append(Step(name, RUN, "; ".join([*words[:3], *(["..."] if words[3:] else [])]), key, preimage))
    return steps


def preimage_for(bound: Bound, store: Store, output: Callable[[str, str], Stored]) -> dict[str, Any]:
    """The pre-image of a node's key, given the recorded outputs of the nodes before it."""
    inputs = {}
    for port, link in bound.inputs.items():
        stored = output(link.node, link.port)
        if (stored.type, stored.digest) != ABSENT:
            inputs[port] = (stored.type, stored.digest)
    remember_in(store.code)
    try:
        sources = {name: store.sources.digest(path) for name, path in bound.sources.items()}
    except OSError as error:
        what = f"{bound.name}: a source file cannot be read: {error.strerror}"
        raise GraphError(what, where=str(error.filename), fix="it was there when the graph was checked") from error
    return preimage_of(bound, fingerprint(bound.definition).digest, sources, inputs)
