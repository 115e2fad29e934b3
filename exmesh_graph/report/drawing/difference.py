"""Two graphs in one picture: what is added, removed, changed, and what would run again."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from exmesh_graph.report.collect import wires_of
from exmesh_graph.report.differences import CHANGED, REMOVED, Difference, component_words
from exmesh_graph.report.drawing.states import fold_boxes, plugged_components, wire_lines
from exmesh_graph.report.drawing.svg import Box, GraphPicture, fold_edges, fold_loops


def picture_of_difference(
    old: Mapping[str, Any], new: Mapping[str, Any], change: Difference, again: Collection[str], title: str,
    rounds: bool = False,
) -> GraphPicture:  # fmt: skip
    """Two resolved graphs: green what is added, red what is removed, amber what is changed; `again` are nodes to run.

    `rounds` draws each round of a repeat block; else they are one box.
    """
    boxes = []
    removed = {name: entry for name, entry in old["nodes"].items() if change.states.get(name) == REMOVED}
    for name, entry in {**new["nodes"], **removed}.items():
        state = change.states.get(name, "rerun" if name in again else "")
        words = [*change.words.get(name, []), *_plugged_words(entry, old, new)]
        if words and state in ("", "rerun"):
            state = CHANGED
        note = ""
        if state == CHANGED:
            first = f"{words[0].partition(' from ')[0]} rewired" if " from @" in words[0] else words[0]
            note = first if len(first) <= 40 else first[:39] + "…"
            note += f" +{len(words) - 1}" if words[1:] else ""
        boxes.append(Box(name, entry["type"], state, note=note, hover=(*words, *wire_lines(entry, {}))))
    plugs, plugged = plugged_components(new, new["nodes"])
    boxes = [*plugs, *boxes]
    named = change.renamed
    wires = [
        (named.get(a, a), named.get(b, b))
        for graph in (new, old)
        for a, b in wires_of({name: entry["inputs"] for name, entry in graph["nodes"].items()})
    ] + plugged
    if rounds:
        return GraphPicture(boxes, list(dict.fromkeys(wires)), edge_states=change.wires, title=title)
    states: dict[tuple[str, str], set[str]] = {}
    for wire in wires:
        for folded in fold_edges([wire]) or fold_loops([wire]):
            states.setdefault(folded, set()).add(change.wires.get(wire, ""))
    edge_states = {wire: next(iter(told)) for wire, told in states.items() if len(told) == 1}
    loops = [loop for loop in fold_loops(wires) if edge_states.get(loop) != REMOVED]
    return GraphPicture(fold_boxes(boxes), fold_edges(wires), loops, edge_states, title)


def _plugged_words(entry: Mapping[str, Any], old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What is other in the components that are plugged into a node."""
    before, after = old.get("components", {}), new.get("components", {})
    lines = []
    for name in (str(link).removeprefix("@") for link in entry.get("components", {}).values()):
        if name in before and name in after and before[name] != after[name]:
            own = [word for _, word in component_words({name: before[name]}, {name: after[name]})]
            lines += [f"{name}: {word}" for word in own or ["a component in it changed"]]
    return lines
