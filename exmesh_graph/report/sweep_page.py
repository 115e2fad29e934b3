"""The self-contained page of a sweep: charts and the table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from importlib import resources
from typing import Any

from exmesh_graph.report.sweep_charts import Mark, difference_chart, scatter_chart, signed
from exmesh_graph.report.sweep_pictures import Shown, versus_section
from exmesh_graph.report.text import number, seconds
from exmesh_graph.report.viewer import viewer_section


def render_sweep(table: Mapping[str, Any], shown: Shown | None = None) -> str:
    """HTML text of a sweep's table (docs/variants.md) and of what its variants look like; works offline."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    here = resources.files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(number=number, seconds=seconds, signed=signed)
    template = environment.from_string((here / "sweep.html").read_text(encoding="utf-8"))
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
    style = Markup((here / "style.css").read_text(encoding="utf-8") + (here / "sweep.css").read_text(encoding="utf-8"))
    labels = {(row["file"], row["variant"]): row["label"] for row in rows}
    shown = shown or Shown()
    return template.render(
        table=table,
        rows=rows,
        tabs=tabs,
        repeats=repeats,
        style=style,
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


def label_of(row: Mapping[str, Any], several_files: bool) -> str:
    """The variant's name, with its file where the sweep spans several."""
    return f"{row['file']}/{row['variant']}" if several_files else str(row["variant"])


def verdict(figure: Mapping[str, Any], entry: Mapping[str, Any]) -> str:
    """better, worse, same (within the spread) or other (no direction is better) than the base; "" where unknown."""
    difference = entry.get("difference")
    if difference is None:
        return ""
    if difference == 0 or entry.get("exceeds") is False:
        return "same"
    if figure["better"] not in ("higher", "lower"):
        return "other"
    return "better" if (difference > 0) == (figure["better"] == "higher") else "worse"


def _cells(row: Mapping[str, Any], table: Mapping[str, Any]) -> list[dict[str, Any]]:
    cells = []
    for figure in table["figures"]:
        entry = row["figures"].get(figure["label"], {})
        cells.append({"entry": entry, "text": text_of(entry), "verdict": verdict(figure, entry)})
    return cells


def text_of(entry: Mapping[str, Any]) -> str:
    """`31.2 ± 0.1`, `yes`, `2 of 3`, or an en dash."""
    values = entry.get("values") or []
    if values and all(isinstance(value, bool) for value in values):
        return number(values[0]) if len(set(values)) == 1 else f"{sum(values)} of {len(values)}"
    mean, spread = entry.get("mean"), entry.get("spread")
    if mean is None:
        return "–"
    if spread:
        digits = max(0, 1 - math.floor(math.log10(spread)))  # two digits of the spread carry meaning
        return f"{mean:,.{digits}f} ± {spread:,.{digits}f}".replace(",", "\u202f")
    whole = isinstance(mean, float) and mean.is_integer() and all(isinstance(value, int) for value in values)
    return number(int(mean) if whole else mean)


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
