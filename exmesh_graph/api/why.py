"""Why a node is a hit or must run: its key, what that depends on, what differs from the nearest earlier record."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from exmesh_graph.api.board import clock
from exmesh_graph.api.opening import Folder, Settings, Source, checked_graph, named, open_store
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.run.plan import plan
from exmesh_graph.graph.run.why import differences, explain, record_time

SCHEMA = "exmesh.why.v1"


@dataclass(frozen=True)
class Why:
    """A node's state (hit, run, unknown) and key; `lines` say what differs; `waits_for` is what must run first."""

    node: str
    state: str
    key: str | None
    reason: str
    made: str = ""
    lines: tuple[str, ...] = ()
    depends_on: dict[str, Any] = field(default_factory=dict)
    waits_for: str = ""

    def as_json(self) -> dict[str, Any]:
        """What `exmesh why --json` writes."""
        return {"schema": SCHEMA, **asdict(self)}


def why(
    graph: Source, node: str, *, set: Settings = None, variant: str | None = None, store: Folder = None, **params: Any
) -> Why:
    """Why a node of a graph is a hit or must run. Raises GraphErrors."""
    checked = checked_graph(graph, set, variant, **params)
    (name,), opened = named(checked, [node]), open_store(store)
    steps = {step.name: step for step in plan(checked, opened, checked.needed_for([name]), reasons=False)}
    step, bound = steps[name], checked.nodes[name]
    if step.preimage is None:
        return Why(name, step.state, None, step.reason, waits_for=step.reason.removeprefix("waits for ").split(",")[0])
    depends: dict[str, Any] = {key: step.preimage[key] for key in ("type", "version", "seed")}
    for key in ("params", "libraries", "sources", "inputs", "components"):
        if step.preimage.get(key):
            depends[key] = list(step.preimage[key])
    depends["code"] = list(fingerprint(bound.definition).parts)
    made, lines = "", []
    if step.action is None:
        lines += explain(bound, step.preimage, opened)
    else:
        info = step.action.info
        spent = clock(float(info.get("seconds", 0)))
        made = f"{record_time(step.action)} by {info.get('node')} of {info.get('graph')} in {spent}"
        lines += differences(step.preimage, step.action, bound)
    return Why(name, step.state, step.key, step.reason, made, tuple(lines), depends)
