"""What a run would do with each node, and why: its key, what that depends on, what differs from an earlier record."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.board import clock
from exmesh_graph.api.opening import Folder, Names, Settings, Source, checked_graph, open_store, using
from exmesh_graph.api.selecting import matching, selected
from exmesh_graph.api.unseen import undeclared, unseen
from exmesh_graph.graph.cache.fingerprint import fingerprint
from exmesh_graph.graph.run.plan import HIT, IDLE, RUN, UNKNOWN
from exmesh_graph.graph.run.plan import plan as steps_of
from exmesh_graph.report.differences import named_in_short
from exmesh_graph.report.reasons import differences, explain, explained, record_time

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.language.check import Checked
    from exmesh_graph.graph.run.plan import Step
    from exmesh_graph.graph.session import Session


class Plan(list["Step"]):
    """The steps of a run in order, each with name, state, reason and key; as text, a table."""

    def __init__(self, graph: Checked, store: Store, steps: Iterable[Step]) -> None:
        super().__init__(steps)
        self.graph, self.store = graph, store

    @property
    def counts(self) -> dict[str, int]:
        """How many nodes are in which state."""
        return counts_of(step.state for step in self)

    def __str__(self) -> str:
        width = max((len(step.name) for step in self), default=0)
        lines = [f"{step.state:<8}{step.name:<{width + 2}}{step.reason}".rstrip() for step in self]
        lines += [idle_line(self.graph)] if self.graph.idle else []
        lines.append(f"{counted(self.counts)} (below a node that must run)")
        if self.unseen:
            more = f" and {len(self.unseen) - 3} more" if self.unseen[3:] else ""
            lines.append(f"not in any key: {'; '.join(self.unseen[:3])}{more}")
        return "\n".join(lines)

    __repr__ = __str__

    @functools.cached_property
    def unseen(self) -> list[str]:
        """What the code of its nodes depends on that no key holds (see `unseen`)."""
        with self.graph.packs:
            definitions = {d.type: d for step in self for d in self.graph.node(step.name).definitions()}
            told = unseen(definitions.values())
        self.store.save()
        return told

    def as_json(self) -> dict[str, Any]:
        """What `exmesh plan --json` writes."""
        steps = [
            {"name": s.name, "type": self.graph.node(s.name).definition.type, "state": s.state, "reason": s.reason,
             "key": s.key}
            for s in self
        ]  # fmt: skip
        return {"schema": "exmesh.plan.v1", "graph": self.graph.name, "counts": self.counts, "steps": steps,
                "idle": list(self.graph.idle), "not_in_key": self.unseen}  # fmt: skip


def idle_line(graph: Checked) -> str:
    """`left out, since nothing needs them: light, bounce (...)`."""
    return f"left out, since nothing needs them: {named_in_short(graph.idle)} (`run: all` in the graph keeps them)"


def counts_of(states: Iterable[str]) -> dict[str, int]:
    """{hit, run, unknown, idle: how many}"""
    counts = Counter(states)
    return {state: counts[state] for state in (HIT, RUN, UNKNOWN, IDLE)}


def counted(counts: Mapping[str, int]) -> str:
    """`3 hit, 2 to run, 1 unknown`."""
    idle = f", {counts[IDLE]} not needed" if counts[IDLE] else ""
    return f"{counts[HIT]} hit, {counts[RUN]} to run, {counts[UNKNOWN]} unknown{idle}"


def plan(
    graph: Source,
    *,
    set: Settings = None,
    variant: str | None = None,
    nodes: Names = None,
    store: Folder = None,
    shared: str | None = None,
    session: Session | None = None,
    **params: Any,
) -> Plan:
    """What a run would do with each node, and why."""
    with using(session):
        checked = checked_graph(graph, set, variant, store, **params)
        chosen, opened = selected(checked, nodes), open_store(store, shared)
        return Plan(chosen.graph, opened, explained(chosen.graph, opened, chosen.targets))


@dataclass(frozen=True)
class Why:
    """A node's state (hit, run, unknown) and key; `lines` say what differs; `waits_for` is what must run first.

    `not_in_key` are places in its code that depend on what no key holds, `undeclared` libraries that it imports and
    whose version is in no key.
    """

    node: str
    state: str
    key: str | None
    reason: str
    made: str = ""
    lines: tuple[str, ...] = ()
    depends_on: dict[str, Any] = field(default_factory=dict)
    waits_for: str = ""
    not_in_key: tuple[str, ...] = ()
    undeclared: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """What `exmesh why --json` writes."""
        return {"schema": "exmesh.why.v1", **asdict(self)}


def why(
    graph: Source, node: str, *, set: Settings = None, variant: str | None = None, store: Folder = None, **params: Any
) -> Why:
    """Why a node of a graph is a hit or must run. Raises GraphErrors."""
    return why_of(checked_graph(graph, set, variant, store, **params), node, open_store(store))


def why_of(checked: Checked, node: str, opened: Store) -> Why:
    """Why a node of a checked graph is a hit or must run. Raises GraphError for a name that it does not have."""
    checked = checked.with_idle()
    name, *_ = matching(checked, [node])
    steps = {step.name: step for step in steps_of(checked, opened, checked.needed_for([name]))}
    step, bound = steps[name], checked.nodes[name]
    if step.preimage is None:
        waits = step.reason.removeprefix("waits for ").split(",")[0] if step.state == UNKNOWN else ""
        return Why(name, step.state, None, step.reason, waits_for=waits)
    with checked.packs:
        outside = tuple(unseen(bound.definitions()))
        libraries = tuple(sorted({library for one in bound.definitions() for library in undeclared(one)}))
    depends: dict[str, Any] = {key: step.preimage[key] for key in ("type", "version", "seed")}
    for key in ("params", "libraries", "sources", "inputs", "components", "kinds"):
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
    return Why(name, step.state, step.key, step.reason, made, tuple(lines), depends, "", outside, libraries)
