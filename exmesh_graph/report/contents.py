"""What a report holds: figures, curves, pictures; what each stage of the method cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.report.templates import data_uri

#: Stage of a node by the family of its type; families of other packs form stages of their own.
_STAGES = {
    "data": "data", "init": "start", "prior": "start", "appearance": "Stage I", "regulariser": "Stage I",
    "stage1": "Stage I", "mesh": "Stage I", "uv": "Stage I", "transport": "Stage II", "scene": "Stage II",
    "stage2": "Stage II", "export": "export", "evaluate": "scoring", "benchmark": "scoring", "gallery": "pictures",
}  # fmt: skip


@dataclass(frozen=True)
class ReportFigure:
    """One headline figure. `floor` is the score of an uninformed guess, `goal` what was aimed at.

    `series` groups figures of one measure over stages; `after_seconds` the time spent until the scored value was there;
    `over` holds other quantities that the value may be drawn against, by name.
    """

    label: str
    value: float | int | bool | str
    unit: str = ""
    floor: float | None = None
    goal: float | None = None
    better: str = ""
    node: str = ""
    series: str = ""
    after_seconds: float | None = None
    over: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class GalleryItem:
    """A picture (PNG, WebP) of a Gallery, or a model (binary glTF) which the page's viewer turns, with its caption."""

    node: str
    file: str
    title: str
    caption: str
    data: bytes
    panels: int = 0  # of one size, ours and the truth first; 0: not a comparison

    @property
    def is_model(self) -> bool:
        return self.file.endswith(".glb")

    @property
    def data_uri(self) -> str:
        """The picture as it stands in the page."""
        return data_uri(f"image/{Path(self.file).suffix.removeprefix('.')}", self.data)


@dataclass(frozen=True)
class Curve:
    """A history: `values` over `positions` (iterations or seconds).

    `span` is when, in seconds spent on all that it needs, the node began and ended.
    """

    node: str
    name: str
    axis: str
    positions: list[float]
    values: list[float]
    span: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Report:
    """`data` is what report.json holds (docs/report.md); beside it the figures again, and what the page alone shows.

    `figures` are as the nodes name them; in `headline` labels are unique, and the total of the seconds is there too.
    """

    data: dict[str, Any]
    figures: list[ReportFigure]
    headline: list[ReportFigure]
    stages: list[ReportFigure]
    curves: list[Curve]
    shown: list[GalleryItem]


def stage_costs(nodes: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """[{stage, seconds, peak_memory, nodes}] in the order the stages begin; `nodes` as report.json has them.

    peak_memory is the largest of the stage's nodes, in bytes; only the processor's memory is counted. Seconds are those
    of the executions that made the results, also where this run took them from the store.
    """
    rows: dict[str, dict[str, Any]] = {}
    for node in nodes:
        family = node["type"].partition(".")[0]
        stage = _STAGES.get(family, family)
        row = rows.setdefault(stage, {"stage": stage, "seconds": 0.0, "peak_memory": 0, "nodes": 0})
        row["seconds"] += node["seconds"]
        row["peak_memory"] = max(row["peak_memory"], node["peak_memory"])
        row["nodes"] += 1
    return list(rows.values())


def fields_of(item: Any, *left_out: str) -> dict[str, Any]:
    """The fields of a dataclass by name."""
    return {name: value for name, value in vars(item).items() if name not in left_out}
