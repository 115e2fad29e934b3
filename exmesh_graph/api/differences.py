"""How two graphs or runs differ, and what would run again: `print(ex.diff("a.yaml", variant="no_merge"))`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.arguments import file_of
from exmesh_graph.api.builder import Graph
from exmesh_graph.api.opening import Settings, Source, checked_graph, using
from exmesh_graph.api.results import Run, read_run
from exmesh_graph.graph.variants.compare import (
    CHANGED,
    REMOVED,
    Difference,
    compare,
    component_words,
    named_in_short,
    rerun,
)
from exmesh_graph.graph.variants.merge import identities

if TYPE_CHECKING:
    from exmesh_graph.graph.session import Session
    from exmesh_graph.report.drawing.svg import GraphPicture


class Side:
    """One side of a comparison: a graph, one of its variants, or a run (its handle or folder)."""

    def __init__(self, source: Source | Run, set: Settings = None, variant: str | None = None, **params: Any) -> None:
        record: Mapping[str, Any] | None = None
        if isinstance(source, Run):
            record, self.folder = source.record, source.folder
        elif not isinstance(source, Graph) and file_of(source).is_dir():
            record, self.folder = read_run(Path(source)), Path(source)
        self.ran = record is not None
        if record is not None:
            self.name, self.resolved = str(record["id"]), record["resolved"]
            self.identities = {row["name"]: row["key"] for row in record["nodes"] if row.get("key")}
        else:
            assert not isinstance(source, Run)
            checked = checked_graph(source, set, variant, **params)
            stem = source.name if isinstance(source, Graph) else Path(source).stem
            self.name = f"{stem} {variant}" if variant else stem
            self.resolved, self.identities = checked.resolved(), identities(checked)

    def figures(self) -> Mapping[str, Any]:
        """The headline figures of a run's report, where there is one."""
        import json

        path = self.folder / "report.json"
        return json.loads(path.read_text(encoding="utf-8"))["headline"] if path.is_file() else {}  # type: ignore[no-any-return]


class Comparison:
    """The difference of two sides. True where there is one; as text, one sentence a line."""

    def __init__(self, old: Side, new: Side) -> None:
        self.old, self.new = old, new
        by_identity = {identity: name for name, identity in new.identities.items()}
        same = {name: by_identity[identity] for name, identity in old.identities.items() if identity in by_identity}
        self.difference: Difference = compare(old.resolved, new.resolved, same)
        #: The nodes of the new side that would run again; None where a run is compared with a graph that has not run.
        self.rerun = rerun(old.identities, new.identities) if old.ran == new.ran else None

    def __bool__(self) -> bool:
        return bool(self.difference)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    __repr__ = __str__

    def lines(self) -> list[str]:
        """All of it in sentences."""
        lines = self.difference.lines() or ["the graphs are the same"]
        if self.rerun is None:
            return lines
        again, total = self.rerun, len(self.new.identities)
        if not self.new.ran:
            tail = f"; new or below a change: {named_in_short(again)}" if again else ""
            return [*lines, f"{total - len(again)} of {total} nodes stay as they are{tail}"]
        odd = [name for name in again if name not in self.difference.states and self._inputs_same(name, again)]
        if odd:
            lines.append(f"other code, libraries or source files: {named_in_short(odd)}")
        return [*lines, *self._figures(), f"{total - len(again)} of {total} keys are the same"]

    def picture(self, rounds: bool = False) -> GraphPicture:
        """Both graphs in one picture: green what is added, red what is removed, amber what is changed."""
        from exmesh_graph.report.drawing.states import fold_boxes, plugged_components, wire_lines
        from exmesh_graph.report.drawing.svg import Box, GraphPicture, fold_edges, fold_loops

        old, new, change, again = self.old.resolved, self.new.resolved, self.difference, {*(self.rerun or ())}
        boxes = []
        removed = {name: entry for name, entry in old["nodes"].items() if change.states.get(name) == REMOVED}
        for name, entry in {**new["nodes"], **removed}.items():
            state = change.states.get(name, "rerun" if name in again else "")
            words = [*change.words.get(name, []), *self._plugged_words(entry)]
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
        wires = [(a, b) for graph in (new, old) for a, b in _edges(graph, change.renamed)] + plugged
        title = f"{self.old.name} → {self.new.name}"
        if rounds:
            return GraphPicture(boxes, list(dict.fromkeys(wires)), edge_states=change.wires, title=title)
        states: dict[tuple[str, str], set[str]] = {}
        for wire in wires:
            for folded in fold_edges([wire]) or fold_loops([wire]):
                states.setdefault(folded, set()).add(change.wires.get(wire, ""))
        edge_states = {wire: next(iter(told)) for wire, told in states.items() if len(told) == 1}
        loops = [loop for loop in fold_loops(wires) if edge_states.get(loop) != REMOVED]
        return GraphPicture(fold_boxes(boxes), fold_edges(wires), loops, edge_states, title)

    def _plugged_words(self, entry: Mapping[str, Any]) -> list[str]:
        """What is other in the components that are plugged into a node."""
        old, new = (side.resolved.get("components", {}) for side in (self.old, self.new))
        lines = []
        for name in (str(link).removeprefix("@") for link in entry.get("components", {}).values()):
            if name in old and name in new and old[name] != new[name]:
                own = [word for _, word in component_words({name: old[name]}, {name: new[name]})]
                lines += [f"{name}: {word}" for word in own or ["a component in it changed"]]
        return lines

    def _inputs_same(self, name: str, again: list[str]) -> bool:
        inputs = self.new.resolved["nodes"].get(name, {}).get("inputs", {}).values()
        return not any(str(link).removeprefix("@").rpartition(".")[0] in again for link in inputs)

    def _figures(self) -> list[str]:
        """Headline figures of two runs side by side."""
        old, new = self.old.figures(), self.new.figures()
        lines = []
        for label in dict.fromkeys([*old, *new]):
            before, after = (entry.get(label, {}).get("value") for entry in (old, new))
            if before != after:
                unit = (new.get(label) or old.get(label) or {}).get("unit", "")
                lines.append(f"{label}: {_figure(before)} -> {_figure(after)} {unit}".rstrip())
        return lines


def diff(
    old: Source | Run | os.PathLike[str],
    new: Source | Run | os.PathLike[str] | None = None,
    *,
    set: Settings = None,
    variant: str | None = None,
    session: Session | None = None,
    **params: Any,
) -> Comparison:
    """How two graphs or runs differ. Settings, variant and graph parameters apply to `new`, by default `old`."""
    with using(session):
        return Comparison(Side(old), Side(old if new is None else new, set, variant, **params))


def _edges(graph: Mapping[str, Any], renamed: Mapping[str, str]) -> list[tuple[str, str]]:
    wires = []
    for name, entry in graph["nodes"].items():
        for link in entry["inputs"].values():
            source = str(link).removeprefix("@").rpartition(".")[0]
            wires.append((renamed.get(source, source), renamed.get(name, name)))
    return wires


def _figure(value: Any) -> str:
    return "nothing" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
