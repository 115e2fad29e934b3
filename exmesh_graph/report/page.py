"""`report.json` and `report.html` of a run; style, charts and pictures are all inside the page.

Nothing heavy is imported here: the report is also written after a run that took everything from the store.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.report.charts import bar_chart, line_chart, thin
from exmesh_graph.report.collect import collect
from exmesh_graph.report.contents import Curve, Report, ReportFigure, stage_costs
from exmesh_graph.report.decisions import decision_tables
from exmesh_graph.report.drawing.states import fold_boxes
from exmesh_graph.report.drawing.svg import Box, fold_edges, fold_loops, fold_name, graph_picture
from exmesh_graph.report.templates import asset_text, page_of, replace_text
from exmesh_graph.report.text import number
from exmesh_graph.report.widgets import comparison, viewer_section


def build_report(run_folder: Path, run_record: Mapping[str, Any], load_artifact: Callable[[str], Any]) -> Path:
    """Write `report.json` and the self-contained `report.html` into `run_folder`; return the path of the page.

    run_record     what the run recorded; `nodes` is required, all else is optional (docs/report.md):
                   nodes     [{name, type, state, seconds, outputs {port: {type, digest, bytes}}, warnings [text],
                             peak_rss bytes}]; seconds are those of the execution that made the result, also
                             where this run took it from the store
                   resolved  {nodes: {name: {inputs: {port: "@node.port"}}}}
                   id, graph (its name), file, command, state, seconds, machine
    load_artifact  digest -> the value; called for outputs of type Metrics and Gallery only
    """
    report = collect(run_record, load_artifact, run_name=run_folder.name)
    text = json.dumps(report.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
    replace_text(run_folder / "report.json", text + "\n")
    page = run_folder / "report.html"
    replace_text(page, render_page(report))
    return page


def render_page(report: Report) -> str:
    """HTML text of the report; works offline."""
    from markupsafe import Markup

    boxes = fold_boxes(Box(node.name, node.type, node.state, node.seconds, 1, node.bytes) for node in report.nodes)
    return page_of(
        __package__,
        "report.html",
        report=report,
        style=Markup(asset_text(__package__, "style.css")),
        tiles=[_tile(figure) for figure in _last_stages(report.headline)],
        bars=Markup(bar_chart([(_label(box), box.seconds or 0.0, box.state) for box in boxes])),
        error_charts=[Markup(chart) for chart in error_charts(report.stages)],
        history_charts=[(node, [Markup(chart) for chart in charts]) for node, charts in _history_charts(report)],
        graph=Markup(graph_picture(boxes, fold_edges(report.edges), fold_loops(report.edges))),
        viewer=Markup(viewer_section([(f"{model.title} ({model.node})", model) for model in reversed(report.models)])),
        galleries=_galleries(report),
        comparison=lambda picture: Markup(comparison(picture)),
        costs=stage_costs(report.nodes),
        decisions=decision_tables(report.metrics),
        tables={node: list(metric_rows(values)) for node, values in report.metrics.items()},
        hits=sum(node.state == "hit" for node in report.nodes),
    )


def _label(box: Box) -> str:
    text = box.name if box.count == 1 else f"{box.name} ×{box.count}"
    return text if len(text) <= 26 else text[:25] + "…"


def _last_stages(figures: list[ReportFigure]) -> list[ReportFigure]:
    """Each measure at its last stage only (the table has them all); those with a floor come first."""
    last: dict[str, ReportFigure] = {}
    for figure in figures:
        if figure.series:
            rival = last.get(figure.series)
            if rival is None or (figure.after_seconds or 0.0) >= (rival.after_seconds or 0.0):
                last[figure.series] = figure
    shown = [figure for figure in figures if not figure.series or last[figure.series] is figure]
    return sorted(shown, key=lambda figure: figure.floor is None)


def _tile(figure: ReportFigure) -> dict[str, Any]:
    """A headline figure with the lengths of its bar (0 to 1), where a bar says something."""
    tile: dict[str, Any] = {"figure": figure, "bar": None, "floor": None, "goal": None}
    value = figure.value
    marks = [mark for mark in (figure.floor, figure.goal) if mark is not None]
    if marks and isinstance(value, int | float) and not isinstance(value, bool) and value >= 0:
        top = 1.08 * max(value, *marks)
        if top > 0:
            tile["bar"] = value / top
            tile["floor"] = None if figure.floor is None else figure.floor / top
            tile["goal"] = None if figure.goal is None else figure.goal / top
    return tile


def error_charts(figures: list[ReportFigure]) -> list[str]:
    """For each measure its value at every scored stage, over the time spent until then (a single one from the floor at
    0 s) and over each other quantity that the stages name; log axes where values span more than a factor of two."""
    charts = []
    for series in dict.fromkeys(figure.series for figure in figures if figure.series):
        members = [f for f in figures if f.series == series and f.after_seconds is not None]
        members = [f for f in members if isinstance(f.value, int | float) and not isinstance(f.value, bool)]
        if not members:
            continue
        title = f"{series}, {members[0].unit}" if members[0].unit else series
        floor = next((f.floor for f in members if f.floor is not None), None)
        timed = sorted((float(f.after_seconds or 0.0), float(f.value)) for f in members)
        if floor is not None and len(timed) == 1:
            timed = [(0.0, floor), *timed]
        drawn = [(timed, "seconds spent", floor)]
        for name in dict.fromkeys(name for f in members for name in f.over):
            drawn.append((sorted((f.over[name], float(f.value)) for f in members if name in f.over), name, None))
        for points, x_label, line in drawn:
            if len(points) < 2:
                continue
            xs, ys = zip(*points, strict=True)
            log = "x" if xs[0] > 0 and xs[-1] > 2 * xs[0] else ""
            if min(ys) > 0 and members[0].unit != "dB":  # decibels are logarithms already
                log += "y" if max(ys) > 2 * min(ys) else ""
            shown = line if line or "y" not in log else None
            charts.append(
                line_chart([(series, xs, ys)], title=title, x_label=x_label, floor=shown, points=True, log=log,
                           width=250, height=176)
            )  # fmt: skip
    return charts


def _history_charts(report: Report) -> list[tuple[str, list[str]]]:
    """One chart per node and quantity; the rounds of a repeat block follow each other in one chart."""
    groups: dict[tuple[str, str], list[Any]] = {}
    for curve in report.curves:
        groups.setdefault((fold_name(curve.node), curve.name), []).append(curve)
    charts: dict[str, list[str]] = {}
    for (node, name), curves in groups.items():
        lines: list[tuple[str, list[float], list[float]]] = []
        offset = 0.0
        for curve in curves:
            keep = thin(curve.positions)
            shift = offset if curve.positions[0] <= offset else 0.0  # a round may count from its own start
            lines.append((curve.node, [curve.positions[k] + shift for k in keep], [curve.values[k] for k in keep]))
            offset = lines[-1][1][-1]
        charts.setdefault(node, []).append(line_chart(lines, title=name, x_label=curves[0].axis))
        if name == "psnr" and curves[-1].span[1] > curves[0].span[0]:
            timed = [
                (curve.node, _seconds_of(curve), [curve.values[k] for k in thin(curve.positions)]) for curve in curves
            ]
            charts[node].append(line_chart(timed, title=name, x_label="seconds spent, even within a node"))
    return list(charts.items())


def _seconds_of(curve: Curve) -> list[float]:
    """When each kept position was reached, the node's seconds spread evenly over its positions."""
    begun, ended = curve.span
    keep = thin(curve.positions)
    return [begun + (ended - begun) * (k + 1) / len(curve.positions) for k in keep]


def _galleries(report: Report) -> list[tuple[str, list[Any]]]:
    groups: dict[str, list[Any]] = {}
    for picture in report.pictures:
        groups.setdefault(picture.node, []).append(picture)
    return list(reversed(groups.items()))  # the finished asset before its stages


def metric_rows(values: Any, prefix: str = "") -> Any:
    """Flat (name, value) rows of nested metrics, without histories and the headline (shown elsewhere)."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from metric_rows(value, f"{name} · ")
        elif isinstance(value, list):
            if key != "headline" and len(value) <= 16 and all(isinstance(x, int | float | str) for x in value):
                yield name, ", ".join(number(x) for x in value)
        else:
            yield name, number(value)
