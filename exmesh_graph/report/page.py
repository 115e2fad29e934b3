"""`report.json` and `report.html` of a run; style, charts and pictures are all inside the page.

Nothing heavy is imported here: the report is also written after a run that took everything from the store.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from exmesh_graph.report.charts import Mark, bar_chart, gain_bar, line_chart, thin
from exmesh_graph.report.collect import collect, number_of
from exmesh_graph.report.contents import Curve, Report, ReportFigure
from exmesh_graph.report.drawing.states import fold_boxes
from exmesh_graph.report.drawing.svg import Box, fold_name, graph_picture
from exmesh_graph.report.templates import page_of, replace_text
from exmesh_graph.report.text import number, seconds
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
    text = json.dumps(report.data, indent=1, ensure_ascii=False, allow_nan=False)
    replace_text(run_folder / "report.json", text + "\n")
    page = run_folder / "report.html"
    replace_text(page, render_page(report))
    return page


def render_page(report: Report) -> str:
    """HTML text of the report; works offline."""
    from markupsafe import Markup

    nodes = report.data["nodes"]
    boxes = fold_boxes(Box(n["name"], n["type"], n["state"], n["seconds"], 1, n["bytes"]) for n in nodes)
    bars = [Mark(f"{box.name} ×{box.count}" if box.count > 1 else box.name, box.seconds or 0.0, kind=box.state)
            for box in boxes]  # fmt: skip
    models = [(f"{one.title} ({one.node})", one) for one in reversed(report.shown) if one.is_model]
    galleries: dict[str, list[Any]] = {}
    for picture in (one for one in report.shown if not one.is_model):
        galleries.setdefault(picture.node, []).append(picture)
    return page_of(
        __package__,
        "report.html",
        report=report.data,
        headline=report.headline,
        tiles=[_tile(figure) for figure in _last_stages(report.headline)],
        bars=Markup(bar_chart(bars, seconds, name="seconds per node")),
        error_charts=[Markup(chart) for chart in error_charts(report.stages)],
        history_charts=[(node, [Markup(chart) for chart in charts]) for node, charts in _history_charts(report)],
        graph=Markup(graph_picture(boxes, report.data["edges"])),
        viewer=Markup(viewer_section(models)),
        galleries=list(reversed(galleries.items())),  # the finished asset before its stages
        comparison=lambda picture: Markup(comparison(picture)),
        advice=advice_rows(report.data["metrics"]),
        decisions=decision_tables(report.data["metrics"]),
        tables={node: list(metric_rows(values)) for node, values in report.data["metrics"].items()},
        hits=sum(node["state"] == "hit" for node in nodes),
    )


def advice_rows(metrics: Mapping[str, Mapping[str, Any]]) -> list[dict[str, str]]:
    """Rows {name, value, reason} of all figures that hold a list named `advice`."""
    rows = [row for values in metrics.values() if isinstance(values.get("advice"), list) for row in values["advice"]]
    told = [row for row in rows if isinstance(row, Mapping) and "name" in row]
    return [{key: str(row.get(key) or "") for key in ("name", "value", "reason")} for row in told]


def decision_tables(metrics: Mapping[str, Mapping[str, Any]]) -> dict[str, list[dict[str, str]]]:
    """What was modelled and why: by `node.port`, for all figures that hold a list named `decisions`, its rows as shown.

    Ports that tell the same share one table, named by all. Texts are empty where nothing was measured.
    """
    tables: list[tuple[list[str], Sequence[Mapping[str, Any]]]] = []
    for port, values in metrics.items():
        rows = values.get("decisions")
        if not (rows and isinstance(rows, list) and all(isinstance(row, Mapping) and "name" in row for row in rows)):
            continue
        same = next((ports for ports, told in tables if told == rows), None)
        if same is None:
            tables.append(([port], rows))
        else:
            same.append(port)
    shown = {}
    for ports, rows in tables:
        gains = [abs(row["gain"]) + (row.get("error") or 0) for row in rows if row.get("gain") is not None]
        shown[", ".join(ports)] = [_decision(row, max([*gains, 0.1])) for row in rows]
    return shown


def _decision(row: Mapping[str, Any], reach: float) -> dict[str, str]:
    gain, error = row.get("gain"), row.get("error")
    told = {
        "name": str(row["name"]),
        "value": number(row.get("value")),
        "gain": "" if gain is None else f"{gain:+.2f}" + ("" if error is None else f" ± {error:.2f}") + " dB",
        "reason": str(row.get("reason") or ""),
        "bar": "",
    }
    for name, key in (("cost", "cost"), ("measured", "seconds_ratio")):
        told[name] = "" if row.get(key) is None else f"{100 * (row[key] - 1):+.0f} %"
    if gain is not None:
        off = not row.get("value") or gain <= 0
        told["bar"] = gain_bar(Mark(f"{gain:+.2f} dB", gain, spread=error, kind="hit" if off else ""), reach)
    return told


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
    lengths = {"bar": number_of(figure.value), "floor": figure.floor, "goal": figure.goal}
    known = [length for length in lengths.values() if length is not None]
    if len(known) < 2 or lengths["bar"] is None or lengths["bar"] < 0 or max(known) <= 0:
        return {"figure": figure}
    return {"figure": figure} | {
        name: value / (1.08 * max(known)) for name, value in lengths.items() if value is not None
    }


def error_charts(figures: list[ReportFigure]) -> list[str]:
    """For each measure its value at every scored stage, over the time spent until then (a single one from the floor at
    0 s) and over each other quantity that the stages name; log axes where values span more than a factor of two."""
    charts = []
    for series in dict.fromkeys(figure.series for figure in figures if figure.series):
        members = [f for f in figures if f.series == series and None not in (f.after_seconds, number_of(f.value))]
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
            charts.append(line_chart([(series, xs, ys)], title=title, x_label=x_label, floor=shown, points=True,
                                     log=log, width=250, height=176))  # fmt: skip
    return charts


def _history_charts(report: Report) -> list[tuple[str, list[str]]]:
    """One chart per node and quantity; the rounds of a repeat block follow each other in one chart."""
    groups: dict[tuple[str, str], list[Curve]] = {}
    for curve in report.curves:
        groups.setdefault((fold_name(curve.node), curve.name), []).append(curve)
    charts: dict[str, list[str]] = {}
    for (node, name), curves in groups.items():
        lines: list[tuple[str, list[float], list[float]]] = []
        timed: list[tuple[str, list[float], list[float]]] = []  # a node's seconds spread evenly over its positions
        offset = 0.0
        for curve in curves:
            keep, (begun, ended) = thin(curve.positions), curve.span
            shift = offset if curve.positions[0] <= offset else 0.0  # a round may count from its own start
            values = [curve.values[k] for k in keep]
            lines.append((curve.node, [curve.positions[k] + shift for k in keep], values))
            timed.append((curve.node, [begun + (ended - begun) * (k + 1) / len(curve.positions) for k in keep], values))
            offset = lines[-1][1][-1]
        charts.setdefault(node, []).append(line_chart(lines, title=name, x_label=curves[0].axis))
        if name == "psnr" and curves[-1].span[1] > curves[0].span[0]:
            charts[node].append(line_chart(timed, title=name, x_label="seconds spent, even within a node"))
    return list(charts.items())


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
