"""The self-contained page of a sweep: charts and the table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from exmesh_graph.report.sweep.charts import Mark, difference_chart, scatter_chart
from exmesh_graph.report.sweep.pictures import SweepPictures, versus_section
from exmesh_graph.report.sweep.table import label_of, text_of, verdict
from exmesh_graph.report.templates import asset_text, page_of
from exmesh_graph.report.widgets import viewer_section


def render_sweep(table: Mapping[str, Any], shown: SweepPictures | None = None) -> str:
    """HTML text of a sweep's table (docs/variants.md) and of what its variants look like; works offline."""
    from markupsafe import Markup

    several = len({row["file"] for row in table["variants"]}) > 1
    rows = [{**row, "label": label_of(row, several), "cells": _cells(row, table)} for row in table["variants"]]
    tabs = []
    for figure in table["figures"]:
        marks, differences = _marks(rows, figure)
        if len({mark.y for mark in marks}) > 1:
            unit = f" ({figure['unit']})" if figure["unit"] else ""
            better = f"{figure['better']} is better" if figure["better"] else ""
            title = f"{figure['label']}{unit}"
            tabs.append((figure["label"], Markup(scatter_chart(marks, title=title, y_label=better)),
                         Markup(difference_chart(differences, title="Difference to the base"))))  # fmt: skip
    repeats = max(len(row["repeats"]) for row in rows)
    style = asset_text("exmesh_graph.report", "style.css") + asset_text(__package__, "style.css")
    labels = {(row["file"], row["variant"]): row["label"] for row in rows}
    shown = shown or SweepPictures()
    return page_of(
        __package__,
        "page.html",
        table=table,
        rows=rows,
        tabs=tabs,
        repeats=repeats,
        style=Markup(style),
        versus=Markup(versus_section(shown, labels, best_of(table))),
        viewer=Markup(
            viewer_section([(_together(labels[key] for key in keys), model) for keys, model in shown.models])
        ),
        models_left_out=shown.models_left_out,
    )


def best_of(table: Mapping[str, Any]) -> tuple[tuple[str, str], str] | None:
    """((file, variant), label of the figure) of the best mean of the first figure that has a direction."""
    figure = next((figure for figure in table["figures"] if figure["better"] in ("higher", "lower")), None)
    if figure is None:
        return None
    means = {
        (row["file"], row["variant"]): row["figures"].get(figure["label"], {}).get("mean") for row in table["variants"]
    }
    known = {key: float(mean) for key, mean in means.items() if isinstance(mean, int | float)}
    if not known:
        return None
    return (max if figure["better"] == "higher" else min)(known, key=lambda key: known[key]), str(figure["label"])


def _together(labels: Iterable[str]) -> str:
    names = list(labels)
    return ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:3])} and {len(names) - 3} more"


def _cells(row: Mapping[str, Any], table: Mapping[str, Any]) -> list[dict[str, Any]]:
    cells = []
    for figure in table["figures"]:
        entry = row["figures"].get(figure["label"], {})
        cells.append({"entry": entry, "text": text_of(entry), "verdict": verdict(figure, entry)})
    return cells


def _marks(rows: list[dict[str, Any]], figure: Mapping[str, Any]) -> tuple[list[Mark], list[Mark]]:
    marks, differences = [], []
    for row in rows:
        entry = row["figures"].get(figure["label"], {})
        values = entry.get("values") or [""]
        if any(isinstance(value, bool | str) for value in values):
            continue
        kind = "base" if row["variant"] == "base" else verdict(figure, entry)
        marks.append(Mark(row["label"], entry["after_seconds"], entry["mean"], entry["spread"], kind))
        if "difference" in entry:
            differences.append(Mark(row["label"], entry["difference"], 0.0, entry["difference_spread"], kind))
    return marks, differences
