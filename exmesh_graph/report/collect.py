"""Everything a report says, gathered from the run record and the Metrics and Gallery artifacts."""

from __future__ import annotations

import base64
import json
import platform
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from exmesh_graph.report.lineage import cumulative_seconds, edges_between

SCHEMA = "exmesh.report.v1"
_LIBRARIES = ("torch", "numpy", "warp-lang", "embreex", "xatlas", "open3d", "usd-core", "OpenImageIO")


@dataclass(frozen=True)
class Node:
    """One node of the run. `seconds` is the cost of its result, whether it ran now or came from the store."""

    name: str
    type: str
    state: str
    seconds: float
    peak_rss: int
    bytes: int
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Figure:
    """One headline figure. `floor` is the score of an uninformed guess, `goal` what was aimed at.

    `series` groups figures of one measure over stages; `after` is the time spent until the scored value was there;
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
    after: float | None = None
    over: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Picture:
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
class Model:
    """A binary glTF file of a Gallery, which the page's viewer turns (view/model.py)."""

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
    nodes: list[Node]
    edges: list[tuple[str, str]]
    headline: list[Figure]
    stages: list[Figure]
    metrics: dict[str, dict[str, Any]]
    curves: list[Curve]
    pictures: list[Picture]
    models: list[Model]
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
        from exmesh_graph.report.costs import stage_costs

        return {
            "schema": SCHEMA,
            "name": self.name,
            "run": self.run,
            "graph": self.graph,
            "command": self.command,
            "state": self.state,
            "seconds": {"this_run": self.wall_seconds, "all_results": self.total_seconds},
            "headline": {
                figure.label: {
                    "value": figure.value,
                    "unit": figure.unit,
                    "floor": figure.floor,
                    "goal": figure.goal,
                    "better": figure.better,
                    "node": figure.node,
                    "series": figure.series,
                    "after_seconds": figure.after,
                }
                for figure in self.headline
            },
            "stages": [
                {
                    "label": figure.label,
                    "value": figure.value,
                    "unit": figure.unit,
                    "node": figure.node,
                    "series": figure.series,
                    "after_seconds": figure.after,
                    "over": dict(figure.over),
                }
                for figure in self.stages
            ],
            "metrics": self.metrics,
            "costs": stage_costs(self.nodes),
            "nodes": [
                {
                    "name": node.name,
                    "type": node.type,
                    "state": node.state,
                    "seconds": node.seconds,
                    "peak_memory": node.peak_rss,
                    "bytes": node.bytes,
                    "warnings": list(node.warnings),
                }
                for node in self.nodes
            ],
            "edges": [list(edge) for edge in self.edges],
            "warnings": [{"node": node, "message": text} for node, text in self.warnings],
            "pictures": [
                {"node": p.node, "file": p.file, "title": p.title, "caption": p.caption} for p in self.pictures
            ],
            "models": [
                {"node": m.node, "file": m.file, "title": m.title, "caption": m.caption, "bytes": len(m.data)}
                for m in self.models
            ],
            "machine": self.machine,
            "versions": self.versions,
        }


def collect(record: Mapping[str, Any], load_artifact: Callable[[str], Any], *, run_name: str = "") -> Report:
    """Read the record and load its Metrics and Gallery artifacts."""
    nodes = [_node(entry) for entry in record["nodes"]]
    edges = edges_between(record)
    spent = cumulative_seconds([(node.name, node.seconds) for node in nodes], edges)
    metrics: dict[str, dict[str, Any]] = {}
    figures: list[Figure] = []
    stages: list[Figure] = []
    curves: list[Curve] = []
    pictures: list[Picture] = []
    models: list[Model] = []
    for entry in record["nodes"]:
        for port, output in sorted((entry.get("outputs") or {}).items()):
            if output["type"] == "Metrics":
                values = load_artifact(output["digest"]).values
                metrics[f"{entry['name']}.{port}"] = values
                figures += _figures(values.get("headline"), entry["name"], spent[entry["name"]])
                stages += _figures(values.get("stages"), entry["name"], spent[entry["name"]])
                begun = spent[entry["name"]]
                ended = begun + float(entry.get("seconds") or 0.0)
                curves += [replace(curve, span=(begun, ended)) for curve in _curves(values, entry["name"])]
            elif output["type"] == "Gallery":
                shown = gallery_of(Path(load_artifact(output["digest"]).root), entry["name"])
                pictures += [one for one in shown if isinstance(one, Picture)]
                models += [one for one in shown if isinstance(one, Model)]
    report = Report(
        name=str(record.get("graph") or run_name or "run"),
        run=str(record.get("id") or run_name),
        graph=Path(str(record.get("file") or "")).name,
        command=str(record.get("command") or ""),
        wall_seconds=_number(record.get("seconds")),
        nodes=nodes,
        edges=edges,
        headline=_unique_labels(figures),
        stages=[*stages, *(figure for figure in figures if figure.series)],
        metrics=metrics,
        curves=curves,
        pictures=pictures,
        models=models,
        state=str(record.get("state") or ""),
        machine={str(key): str(value) for key, value in (record.get("machine") or {}).items()},
        versions=library_versions(),
    )
    report.headline.append(
        Figure("Seconds, total", round(report.total_seconds, 1), "s", better="lower", node="all nodes")
    )
    return report


def _node(entry: Mapping[str, Any]) -> Node:
    outputs = (entry.get("outputs") or {}).values()
    return Node(
        name=str(entry["name"]),
        type=str(entry.get("type") or ""),
        state=str(entry.get("state") or ""),
        seconds=float(entry.get("seconds") or 0.0),
        peak_rss=int(entry.get("peak_rss") or 0),
        bytes=sum(int(output.get("bytes") or 0) for output in outputs),
        warnings=tuple(str(text) for text in entry.get("warnings") or ()),
    )


def _figures(entries: Any, node: str, after: float) -> Iterator[Figure]:
    """Entries {label, value, unit?, floor?, goal?, better?, series?, over?} of a headline or of stages."""
    for entry in entries or ():
        yield Figure(
            label=str(entry["label"]),
            value=entry["value"],
            unit=str(entry.get("unit") or ""),
            floor=_number(entry.get("floor")),
            goal=_number(entry.get("goal")),
            better=str(entry.get("better") or ""),
            node=node,
            series=str(entry.get("series") or ""),
            after=after,
            over={str(name): float(x) for name, x in (entry.get("over") or {}).items()},
        )


def _unique_labels(figures: list[Figure]) -> list[Figure]:
    """Two nodes may report one measure: the label then names the node."""
    labels = [figure.label for figure in figures]
    return [
        Figure(**{**figure.__dict__, "label": f"{figure.label} ({figure.node})"})
        if labels.count(figure.label) > 1
        else figure
        for figure in figures
    ]


def _curves(values: Mapping[str, Any], node: str) -> Iterator[Curve]:
    """Any group of number lists of one length becomes curves over its `iteration`, `step` or `seconds` list."""
    lists = {
        key: value
        for key, value in values.items()
        if isinstance(value, list) and len(value) > 1 and all(_number(item) is not None for item in value)
    }
    axis = next((key for key in ("iteration", "iterations", "step", "steps", "seconds") if key in lists), None)
    if axis is not None:
        for key, series in lists.items():
            if key not in (axis, "seconds") and len(series) == len(lists[axis]):
                yield Curve(node, key, axis, [float(x) for x in lists[axis]], [float(y) for y in series])
    for value in values.values():
        if isinstance(value, Mapping):
            yield from _curves(value, node)


def gallery_of(root: Path, node: str) -> list[Picture | Model]:
    """What the folder of a Gallery holds, in the order of its captions."""
    shown: list[Picture | Model] = []
    for entry in json.loads((root / "captions.json").read_text(encoding="utf-8")):
        words = node, entry["file"], entry.get("title", ""), entry.get("caption", "")
        data = (root / entry["file"]).read_bytes()
        panels = int(entry.get("compare") or 0)
        shown.append(Model(*words, data) if entry["file"].endswith(".glb") else Picture(*words, data, panels))
    return shown


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def library_versions() -> dict[str, str]:
    """Versions of Python, this project and the libraries that carry the work, without importing them."""
    versions = {"python": platform.python_version()}
    for name in ("exmesh-graph", *_LIBRARIES):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions
