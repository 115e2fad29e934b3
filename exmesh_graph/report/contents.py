"""What a report holds: nodes, figures, curves, pictures; its content as JSON; what each stage of the method cost."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

SCHEMA = "exmesh.report.v1"
#: Stage of a node by the family of its type; families of other packs form stages of their own.
_STAGES = {
    "data": "data", "init": "start", "prior": "start", "appearance": "Stage I", "regulariser": "Stage I",
    "stage1": "Stage I", "mesh": "Stage I", "uv": "Stage I", "transport": "Stage II", "scene": "Stage II",
    "stage2": "Stage II", "export": "export", "evaluate": "scoring", "benchmark": "scoring", "gallery": "pictures",
}  # fmt: skip


@dataclass(frozen=True)
class ReportNode:
    """One node of the run. `seconds` is the cost of its result, whether it ran now or came from the store."""

    name: str
    type: str
    state: str
    seconds: float
    peak_memory: int
    bytes: int
    warnings: tuple[str, ...] = ()


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
class GalleryPicture:
    """A PNG or WebP of a Gallery, with its caption."""

    node: str
    file: str
    title: str
    caption: str
    data: bytes
    panels: int = 0  # of one size, ours and the truth first; 0: not a comparison

    @property
    def data_uri(self) -> str:
        """The picture as it stands in the page."""
        kind = Path(self.file).suffix.removeprefix(".")
        return f"data:image/{kind};base64,{base64.b64encode(self.data).decode('ascii')}"


@dataclass(frozen=True)
class GalleryModel:
    """A binary glTF file of a Gallery, which the page's viewer turns (gallery/models.py)."""

    node: str
    file: str
    title: str
    caption: str
    data: bytes


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
    """All contents of one report."""

    name: str
    run: str
    graph: str
    command: str
    wall_seconds: float | None
    nodes: list[ReportNode]
    edges: list[tuple[str, str]]
    headline: list[ReportFigure]
    stages: list[ReportFigure]
    metrics: dict[str, dict[str, Any]]
    curves: list[Curve]
    pictures: list[GalleryPicture]
    models: list[GalleryModel]
    state: str
    machine: dict[str, str]
    versions: dict[str, str] = field(default_factory=dict)

    @property
    def total_seconds(self) -> float:
        """What all results together cost, those taken from the store included."""
        return sum(node.seconds for node in self.nodes)

    @property
    def warnings(self) -> list[tuple[str, str]]:
        """(node, text) of every warning."""
        return [(node.name, text) for node in self.nodes for text in node.warnings]

    def as_json(self) -> dict[str, Any]:
        """The documented content of `report.json`."""
        return {
            "schema": SCHEMA,
            **{name: getattr(self, name) for name in ("name", "run", "graph", "command", "state")},
            "seconds": {"this_run": self.wall_seconds, "all_results": self.total_seconds},
            "headline": {figure.label: _fields(figure, "label", "over") for figure in self.headline},
            "stages": [_fields(figure, "floor", "goal", "better") for figure in self.stages],
            "metrics": self.metrics,
            "costs": stage_costs(self.nodes),
            "nodes": [_fields(node) for node in self.nodes],
            "edges": self.edges,
            "warnings": [{"node": node, "message": text} for node, text in self.warnings],
            "pictures": [_fields(picture, "data", "panels") for picture in self.pictures],
            "models": [{**_fields(model, "data"), "bytes": len(model.data)} for model in self.models],
            "machine": self.machine,
            "versions": self.versions,
        }


def stage_costs(nodes: Sequence[ReportNode]) -> list[dict[str, Any]]:
    """[{stage, seconds, peak_memory, nodes}] in the order the stages begin.

    peak_memory is the largest of the stage's nodes, in bytes; only the processor's memory is counted. Seconds are those
    of the executions that made the results, also where this run took them from the store.
    """
    rows: dict[str, dict[str, Any]] = {}
    for node in nodes:
        family = node.type.partition(".")[0]
        stage = _STAGES.get(family, family)
        row = rows.setdefault(stage, {"stage": stage, "seconds": 0.0, "peak_memory": 0, "nodes": 0})
        row["seconds"] += node.seconds
        row["peak_memory"] = max(row["peak_memory"], node.peak_memory)
        row["nodes"] += 1
    return list(rows.values())


def _fields(item: Any, *left_out: str) -> dict[str, Any]:
    """The fields of a dataclass by name."""
    return {one.name: getattr(item, one.name) for one in fields(item) if one.name not in left_out}
