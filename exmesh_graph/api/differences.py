"""How two graphs or runs differ, and what would run again: `print(ex.diff("a.yaml", variant="no_merge"))`."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.arguments import file_of
from exmesh_graph.api.builder import Graph
from exmesh_graph.api.opening import Settings, Source, checked_graph, stem_of, using
from exmesh_graph.api.provenance import differences
from exmesh_graph.api.results import Run, read_run
from exmesh_graph.graph.variants.compare import identities
from exmesh_graph.report.differences import Difference, compare, named_in_short, rerun

if TYPE_CHECKING:
    from exmesh_graph.graph.session import Session
    from exmesh_graph.report.drawing.svg import GraphPicture


class Side:
    """One side of a comparison: a graph, one of its variants, or a run (its handle or folder)."""

    def __init__(self, source: Source | Run, set: Settings = None, variant: str | None = None, **params: Any) -> None:
        record: Mapping[str, Any] | None = None
        self.provenance: Mapping[str, Any] = {}
        if isinstance(source, Run):
            record, self.folder = source.record, source.folder
        elif not isinstance(source, Graph) and file_of(source).is_dir():
            record, self.folder = read_run(Path(source)), Path(source)
        self.ran = record is not None
        if record is not None:
            self.name, self.resolved = str(record["id"]), record["resolved"]
            self.provenance = record.get("provenance") or {}
            self.identities = {row["name"]: row["key"] for row in record["nodes"] if row.get("key")}
        else:
            assert not isinstance(source, Run)
            checked = checked_graph(source, set, variant, **params)
            self.name = " ".join(filter(None, [stem_of(source), variant]))
            self.resolved, self.identities = checked.resolved(), identities(checked)

    def figures(self) -> Mapping[str, Any]:
        """The headline figures of a run's report, where there is one."""
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
        both = self.old.provenance, self.new.provenance
        lines += differences(*both) if all(both) else []
        return [*lines, *self._figures(), f"{total - len(again)} of {total} keys are the same"]

    def picture(self, rounds: bool = False) -> GraphPicture:
        """Both graphs in one picture: green what is added, red what is removed, amber what is changed."""
        from exmesh_graph.report.drawing.difference import picture_of_difference

        title = f"{self.old.name} → {self.new.name}"
        again = {*(self.rerun or ())}
        return picture_of_difference(self.old.resolved, self.new.resolved, self.difference, again, title, rounds)

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


def _figure(value: Any) -> str:
    return "nothing" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
