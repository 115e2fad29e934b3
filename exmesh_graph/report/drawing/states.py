"""Pictures of a graph as a plan sees it, and of a run: which boxes, in which states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from exmesh_graph.report.collect import edges_between
from exmesh_graph.report.drawing.svg import Box, GraphPicture, fold_edges, fold_loops, fold_name

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.language.check import Bound, Checked

_ORDER = ("failed", "interrupted", "running", "blocked", "waiting", "removed", "added", "changed", "rerun", "run",
          "done", "unknown", "hit", "idle")  # fmt: skip


def picture_of_graph(graph: Checked, store: Store, rounds: bool = False) -> GraphPicture:
    """A graph as a plan sees it: what is in the store, what would run; times and sizes of earlier results.

    `rounds` draws each round of a repeat block; else they are one box.
    """
    from exmesh_graph.graph.run.plan import plan

    steps = {step.name: step for step in plan(graph, store)}
    boxes = []
    for name, bound in graph.nodes.items():
        step = steps[name]
        info = step.action.info if step.action else {}
        size = sum(stored.bytes for stored in step.action.outputs.values()) if step.action else 0
        boxes.append(Box(name, bound.definition.type, step.state, float(info.get("seconds", 0.0)) or None, 1, size,
                         hover=_ports(bound)))  # fmt: skip
    edges = [(link.node, name) for name, bound in graph.nodes.items() for link in bound.inputs.values()]
    plugs, wires = plugged_components(graph.resolved(), graph.nodes)
    return folded([*plugs, *boxes], [*wires, *edges], graph.name, rounds)


def picture_of_run(record: Mapping[str, Any], rounds: bool = False) -> GraphPicture:
    """A run as it ended, or as it is now."""
    resolved = (record.get("resolved") or {}).get("nodes") or {}
    boxes = [
        Box(row["name"], row["type"], row["state"], float(row.get("seconds") or 0.0) or None, 1,
            sum(int(out.get("bytes") or 0) for out in (row.get("outputs") or {}).values()),
            hover=wire_lines(resolved.get(row["name"], {}), row.get("outputs") or {}))
        for row in record["nodes"]
    ]  # fmt: skip
    plugs, wires = plugged_components(record.get("resolved") or {}, {box.name for box in boxes})
    title = str(record.get("id") or record.get("graph"))
    return folded([*plugs, *boxes], [*wires, *edges_between(record)], title, rounds)


def plugged_components(resolved: Mapping[str, Any], drawn: Iterable[str]) -> tuple[list[Box], list[tuple[str, str]]]:
    """A box for each component that is plugged into a drawn node, and the wires to these nodes."""
    told = resolved.get("components") or {}
    nodes = resolved.get("nodes") or {}
    wires = [
        (str(link).removeprefix("@"), name)
        for name in drawn
        for link in (nodes.get(name, {}).get("components") or {}).values()
    ]
    boxes = [
        Box(name, told[name]["type"], note="component", hover=wire_lines(told[name], {}))
        for name in dict.fromkeys(source for source, _ in wires)
    ]
    return boxes, wires


def folded(boxes: Sequence[Box], edges: Sequence[tuple[str, str]], title: str, rounds: bool) -> GraphPicture:
    """The picture with each round drawn, or with one box for all rounds of a node."""
    if rounds:
        return GraphPicture(boxes, edges, title=title)
    return GraphPicture(fold_boxes(boxes), fold_edges(edges), fold_loops(edges), title=title)


def fold_boxes(boxes: Iterable[Box]) -> list[Box]:
    """One box for all rounds of a node."""
    groups: dict[str, list[Box]] = {}
    for box in boxes:
        groups.setdefault(fold_name(box.name), []).append(box)
    result = []
    for name, members in groups.items():
        states = [box.state for box in members]
        state = next((state for state in _ORDER if state in states), states[0])
        moved = sum(state in ("added", "removed") for state in states)
        spent = sum(box.seconds or 0.0 for box in members) or None
        notes = list(dict.fromkeys(box.note for box in members if box.note))
        if 0 < moved < len(members):  # some of its rounds, not the node
            notes.append(f"{moved} round{'s' if moved > 1 else ''} {state}")
            state = "changed"
        kinds = " / ".join(dict.fromkeys(box.type for box in members))
        result.append(Box(name, kinds, state, spent, len(members), sum(box.bytes for box in members),
                          notes[0] if notes else "", members[-1].hover))  # fmt: skip
    return result


def _ports(bound: Bound) -> tuple[str, ...]:
    """What a node's hover text says: wires in, ports out, parameters that differ from their defaults."""
    lines = [f"in   {port}: {bound.signature.inputs[port]}  from {link}" for port, link in bound.inputs.items()]
    lines += [f"in   {port}: @{plug.name}  {plug.definition.type}" for port, plug in bound.components.items()]
    lines += [f"out  {port.name}: {port}" for port in bound.signature.outputs.values()]
    set_here = sorted(bound.params.model_fields_set)
    return (*lines, *(f"{name} = {getattr(bound.params, name)}" for name in set_here))


def wire_lines(entry: Mapping[str, Any], outputs: Mapping[str, Any]) -> tuple[str, ...]:
    """What a resolved node's hover text says: wires in, outputs, parameters."""
    lines = [f"in   {port}  from {link}" for port, link in (entry.get("inputs") or {}).items()]
    lines += [f"out  {port}: {stored.get('type')}" for port, stored in outputs.items()]
    return (*lines, *(f"{name} = {value}" for name, value in (entry.get("params") or {}).items()))
