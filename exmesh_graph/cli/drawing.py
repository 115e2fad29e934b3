"""`exmesh show` and `exmesh diff`: pictures of graphs, runs and differences, and differences in words."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from exmesh_graph.cli.options import checked_graph
from exmesh_graph.cli.show import read_run
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.variants import identities
from exmesh_graph.graph.variants.compare import (
    CHANGED,
    REMOVED,
    Difference,
    compare,
    component_words,
    named_in_short,
    rerun,
)
from exmesh_graph.report.drawing.formats import FORMATS, render, write
from exmesh_graph.report.drawing.states import fold_boxes, plugged_components, wire_lines
from exmesh_graph.report.drawing.svg import Box, GraphPicture, fold_edges, fold_loops


def check_output(path: Path | None) -> None:
    """Refuse a file type that cannot be written, before any work."""
    if path is not None and path.suffix not in FORMATS:
        raise GraphError(f"cannot draw {path.name}", where="command line", expected="a name in " + ", ".join(FORMATS))


def put_out(picture: GraphPicture, path: Path | None) -> None:
    """Write a picture, or print it as Mermaid text."""
    if path is None:
        typer.echo(render(picture, ".mmd"), nl=False)
    else:
        write(picture, path)
        typer.echo(str(path))


class Side:
    """One side of a comparison: a graph file, one of its variants, or a run folder."""

    def __init__(self, path: Path, sets: list[str] | None, variant: str | None) -> None:
        self.run: Mapping[str, Any] | None = None
        if path.is_dir():
            record = read_run(path)
            self.run, self.name = record, str(record["id"])
            self.resolved = record["resolved"]
            self.identities = {row["name"]: row["key"] for row in record["nodes"] if row.get("key")}
            self.folder = path
        else:
            checked, _ = checked_graph(path, sets, variant)
            self.name = f"{path.stem} {variant}" if variant else path.stem
            self.resolved, self.identities = checked.resolved(), identities(checked)


def difference(old: Side, new: Side) -> Difference:
    """How two sides differ."""
    by_identity = {identity: name for name, identity in new.identities.items()}
    same = {name: by_identity[identity] for name, identity in old.identities.items() if identity in by_identity}
    return compare(old.resolved, new.resolved, same)


def show_difference(old: Side, new: Side) -> None:
    """The difference in words, and what would run again."""
    found = difference(old, new)
    for line in found.lines():
        typer.echo(line)
    if not found:
        typer.echo("the graphs are the same")
    if (old.run is None) != (new.run is None):
        return  # keys of a run cannot be compared with a graph that has not run
    again = rerun(old.identities, new.identities)
    unchanged = len(new.identities) - len(again)
    if new.run is not None:
        odd = [name for name in again if name not in found.states and _inputs_same(name, again, new.resolved)]
        if odd:
            typer.echo(f"other code, libraries or source files: {named_in_short(odd)}")
        _show_figures(old, new)
        typer.echo(f"{unchanged} of {len(new.identities)} keys are the same")
    else:
        typer.echo(f"{unchanged} of {len(new.identities)} nodes stay as they are"
                   + (f"; new or below a change: {named_in_short(again)}" if again else ""))  # fmt: skip


def _plugged_words(entry: Mapping[str, Any], old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What is other in the components that are plugged into a node."""
    found = []
    for name in (str(link).removeprefix("@") for link in entry.get("components", {}).values()):
        if name in old and name in new and old[name] != new[name]:
            own = [word for _, word in component_words({name: old[name]}, {name: new[name]})]
            found += [f"{name}: {word}" for word in own or ["a component in it changed"]]
    return found


def picture_of_difference(old: Side, new: Side, rounds: bool) -> GraphPicture:
    """Both graphs in one picture: green what is added, red what is removed, amber what is changed."""
    found = difference(old, new)
    again = set(rerun(old.identities, new.identities)) if (old.run is None) == (new.run is None) else set()
    boxes = []
    removed = {name: entry for name, entry in old.resolved["nodes"].items() if found.states.get(name) == REMOVED}
    for name, entry in {**new.resolved["nodes"], **removed}.items():
        state = found.states.get(name, "rerun" if name in again else "")
        words = list(found.words.get(name, []))
        words += _plugged_words(entry, *(side.resolved.get("components", {}) for side in (old, new)))
        if words and state in ("", "rerun"):
            state = CHANGED
        note = ""
        if state == CHANGED:
            first = f"{words[0].partition(' from ')[0]} rewired" if " from @" in words[0] else words[0]
            note = first if len(first) <= 40 else first[:39] + "…"
            note += f" +{len(words) - 1}" if words[1:] else ""
        boxes.append(Box(name, entry["type"], state, note=note, hover=(*words, *wire_lines(entry, {}))))
    plugs, plugged = plugged_components(new.resolved, new.resolved["nodes"])
    boxes = [*plugs, *boxes]
    wires = [(a, b) for graph in (new.resolved, old.resolved) for a, b in _edges(graph, found.renamed)] + plugged
    title = f"{old.name} → {new.name}"
    if rounds:
        return GraphPicture(boxes, list(dict.fromkeys(wires)), edge_states=found.wires, title=title)
    states: dict[tuple[str, str], set[str]] = {}
    for wire in wires:
        for folded in fold_edges([wire]) or fold_loops([wire]):
            states.setdefault(folded, set()).add(found.wires.get(wire, ""))
    edge_states = {wire: next(iter(found)) for wire, found in states.items() if len(found) == 1}
    loops = [loop for loop in fold_loops(wires) if edge_states.get(loop) != REMOVED]
    return GraphPicture(fold_boxes(boxes), fold_edges(wires), loops, edge_states, title)


def _edges(graph: Mapping[str, Any], renamed: Mapping[str, str]) -> list[tuple[str, str]]:
    wires = []
    for name, entry in graph["nodes"].items():
        for link in entry["inputs"].values():
            source = str(link).removeprefix("@").rpartition(".")[0]
            wires.append((renamed.get(source, source), renamed.get(name, name)))
    return wires


def _inputs_same(name: str, again: Sequence[str], graph: Mapping[str, Any]) -> bool:
    inputs = graph["nodes"].get(name, {}).get("inputs", {}).values()
    return not any(str(link).removeprefix("@").rpartition(".")[0] in again for link in inputs)


def _show_figures(old: Side, new: Side) -> None:
    """Headline figures of two runs side by side."""
    figures = []
    for side in (old, new):
        path = side.folder / "report.json"
        figures.append(json.loads(path.read_text(encoding="utf-8"))["headline"] if path.is_file() else {})
    for label in dict.fromkeys([*figures[0], *figures[1]]):
        before, after = (entry.get(label, {}).get("value") for entry in figures)
        if before != after:
            unit = (figures[1].get(label) or figures[0].get(label) or {}).get("unit", "")
            typer.echo(f"{label}: {_figure(before)} -> {_figure(after)} {unit}".rstrip())


def _figure(value: Any) -> str:
    return "nothing" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
