"""Everything a report says, gathered from the run record and the Metrics and Gallery artifacts."""

from __future__ import annotations

import json
import platform
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from exmesh_graph.report.contents import Curve, GalleryItem, Report, ReportFigure, fields_of, stage_costs
from exmesh_graph.types.results import figure_faults

SCHEMA = "exmesh.report.v1"
_LIBRARIES = ("torch", "numpy", "warp-lang", "embreex", "xatlas", "open3d", "usd-core", "OpenImageIO")


def collect(record: Mapping[str, Any], load_artifact: Callable[[str], Any], *, run_name: str = "") -> Report:
    """Read the record and load its Metrics and Gallery artifacts."""
    nodes = [_node(entry) for entry in record["nodes"]]
    edges = edges_between(record)
    spent = cumulative_seconds([(node["name"], node["seconds"]) for node in nodes], edges)
    metrics: dict[str, dict[str, Any]] = {}
    figures: list[ReportFigure] = []
    stages: list[ReportFigure] = []
    curves: list[Curve] = []
    told = [{"node": node["name"], "message": text} for node in nodes for text in node["warnings"]]
    shown: list[GalleryItem] = []
    for entry in record["nodes"]:
        begun = spent[entry["name"]]
        for port, output in sorted((entry.get("outputs") or {}).items()):
            if output["type"] == "Metrics":
                values = load_artifact(output["digest"]).values
                metrics[f"{entry['name']}.{port}"] = values
                faults = list(figure_faults(values))  # of a store from before such were refused
                figures += _figures(() if faults else values.get("headline"), entry["name"], begun)
                stages += _figures(() if faults else values.get("stages"), entry["name"], begun)
                told += [{"node": entry["name"], "message": f"its figures are left out: {fault}"} for fault in faults]
                ended = begun + float(entry.get("seconds") or 0.0)
                curves += [replace(curve, span=(begun, ended)) for curve in curves_of(values, entry["name"])]
            elif output["type"] == "Gallery":
                shown += gallery_of(Path(load_artifact(output["digest"]).root), entry["name"])
    total = sum(node["seconds"] for node in nodes)
    (headline,) = unique_labels([figures])
    headline.append(ReportFigure("Seconds, total", round(total, 1), "s", better="lower", node="all nodes"))
    stages += [figure for figure in figures if figure.series]
    data = {
        "schema": SCHEMA,
        "name": str(record.get("graph") or run_name or "run"),
        "run": str(record.get("id") or run_name),
        "graph": Path(str(record.get("file") or "")).name,
        "command": str(record.get("command") or ""),
        "state": str(record.get("state") or ""),
        "seconds": {"this_run": number_of(record.get("seconds")), "all_results": total},
        "headline": {figure.label: fields_of(figure, "label", "over") for figure in headline},
        "stages": [fields_of(figure, "floor", "goal", "better") for figure in stages],
        "metrics": metrics,
        "costs": stage_costs(nodes),
        "nodes": nodes,
        "edges": edges,
        "warnings": told,
        "pictures": [fields_of(one, "data", "panels") for one in shown if not one.is_model],
        "models": [fields_of(one, "data", "panels") | {"bytes": len(one.data)} for one in shown if one.is_model],
        "machine": {str(key): str(value) for key, value in (record.get("machine") or {}).items()},
        "versions": library_versions(),
    }
    return Report(data, figures, headline, stages, curves, shown)


def _node(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A node of report.json; seconds are what its result cost, whether it ran now or came from the store."""
    return {
        "name": str(entry["name"]),
        "type": str(entry.get("type") or ""),
        "state": str(entry.get("state") or ""),
        "seconds": float(entry.get("seconds") or 0.0),
        "peak_memory": int(entry.get("peak_rss") or 0),
        "bytes": sum(int(output.get("bytes") or 0) for output in (entry.get("outputs") or {}).values()),
        "warnings": [str(text) for text in entry.get("warnings") or ()],
    }


def _figures(entries: Any, node: str, after: float) -> Iterator[ReportFigure]:
    """Entries {label, value, unit?, floor?, goal?, better?, series?, over?} of a headline or of stages."""
    for entry in entries or ():
        given: dict[str, Any] = {name: str(entry.get(name) or "") for name in ("label", "unit", "better", "series")}
        given |= {name: number_of(entry.get(name)) for name in ("floor", "goal")}
        over = {str(name): float(x) for name, x in (entry.get("over") or {}).items()}
        yield ReportFigure(value=entry["value"], node=node, after_seconds=after, over=over, **given)


def unique_labels(runs: Sequence[Sequence[ReportFigure]]) -> list[list[ReportFigure]]:
    """Where two nodes of one run report a measure, its label names the node, in all of the runs."""
    counts = [Counter(figure.label for figure in figures) for figures in runs]
    twofold = {label for count in counts for label, times in count.items() if times > 1}
    return [
        [replace(f, label=f"{f.label} ({f.node})") if f.label in twofold else f for f in figures] for figures in runs
    ]


def curves_of(values: Mapping[str, Any], node: str) -> Iterator[Curve]:
    """Any group of number lists of one length becomes curves over its `iteration`, `step` or `seconds` list."""
    lists = {
        key: value
        for key, value in values.items()
        if isinstance(value, list) and len(value) > 1 and all(number_of(item) is not None for item in value)
    }
    axis = next((key for key in ("iteration", "iterations", "step", "steps", "seconds") if key in lists), None)
    if axis is not None:
        for key, series in lists.items():
            if key not in (axis, "seconds") and len(series) == len(lists[axis]):
                yield Curve(node, key, axis, [float(x) for x in lists[axis]], [float(y) for y in series])
    for value in values.values():
        if isinstance(value, Mapping):
            yield from curves_of(value, node)


def gallery_of(root: Path, node: str) -> list[GalleryItem]:
    """What the folder of a Gallery holds, in the order of its captions."""
    return [
        GalleryItem(node, entry["file"], entry.get("title", ""), entry.get("caption", ""),
                    (root / entry["file"]).read_bytes(), int(entry.get("compare") or 0))
        for entry in json.loads((root / "captions.json").read_text(encoding="utf-8"))
    ]  # fmt: skip


def number_of(value: Any) -> float | None:
    """A number as float; None for all else, yes and no included."""
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


def edges_between(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(producer, consumer) pairs of a run record, in order, each once.

    Inputs are wires "@node.port", with each node's entry or under `resolved.nodes`.
    """
    resolved = (record.get("resolved") or {}).get("nodes") or {}
    own = {entry["name"]: entry.get("inputs") for entry in record["nodes"]}
    inputs = {name: given or resolved.get(name, {}).get("inputs") or {} for name, given in own.items()}
    return [wire for wire in wires_of(inputs) if wire[0] in own]


def wires_of(inputs: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """(producer, consumer) of the wires {node: {port: "@node.port"}}, each once."""
    pairs = (
        (str(link).removeprefix("@").rpartition(".")[0], name) for name in inputs for link in inputs[name].values()
    )
    return list(dict.fromkeys(pairs))


def cumulative_seconds(nodes: Sequence[tuple[str, float]], edges: Sequence[tuple[str, str]]) -> dict[str, float]:
    """Seconds of all that a node depends on, its own not counted: what its input cost.

    `nodes` are (name, seconds) in the order of execution. A node without a known input counts all before it.
    """
    sources: dict[str, set[str]] = {}
    for producer, consumer in edges:
        sources.setdefault(consumer, set()).add(producer)
    seconds = dict(nodes)
    users = Counter(producer for producer, _ in set(edges))
    place = {name: 1 << index for index, (name, _) in enumerate(nodes)}
    ancestors: dict[str, int] = {}  # as bits, until the last user has asked
    spent: dict[str, float] = {}
    costs: dict[str, float] = {}
    before = 0.0
    for name, own in nodes:
        direct = sources.get(name, set()) & ancestors.keys()
        above = [(costs[node] + seconds[node], ancestors[node] | place[node]) for node in direct]
        costs[name], ancestors[name] = max(above, default=(0.0, 0))  # of the dearest; of the others what it lacks
        for _, bits in above:
            costs[name] += _sum_of(bits & ~ancestors[name], nodes)
            ancestors[name] |= bits
        spent[name] = costs[name] if direct else before
        before += own
        for node in direct:
            users[node] -= 1
            if not users[node]:
                del ancestors[node]
    return spent


def _sum_of(bits: int, nodes: Sequence[tuple[str, float]]) -> float:
    """The seconds of the nodes whose bits are set."""
    total = 0.0
    while bits:
        lowest = bits & -bits
        total += nodes[lowest.bit_length() - 1][1]
        bits ^= lowest
    return total


def collect_benchmarks(record: Mapping[str, Any], load_artifact: Callable[[str], Any]) -> list[dict[str, Any]]:
    """{table, scene, row, seconds} of every scene a run or a sweep has scored; seconds are those its result cost."""
    nodes = [(str(entry["name"]), float(entry.get("seconds") or 0.0)) for entry in record["nodes"]]
    spent = cumulative_seconds(nodes, edges_between(record))
    scenes = []
    for entry in record["nodes"]:
        for output in (entry.get("outputs") or {}).values():
            if output["type"] == "Metrics" and str(entry.get("type")).startswith("benchmark."):
                scored = load_artifact(output["digest"]).values.get("benchmark")
                if scored:
                    scenes.append({**scored, "seconds": spent[entry["name"]]})
    return scenes
