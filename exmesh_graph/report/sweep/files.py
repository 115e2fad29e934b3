"""The files of a sweep: its table as JSON, CSV and Markdown, and its self-contained page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.report.charts import Mark, bar_chart, scatter_chart
from exmesh_graph.report.sweep.pictures import SweepPictures, versus_section
from exmesh_graph.report.sweep.table import label_of, text_of, verdict
from exmesh_graph.report.templates import page_of, replace_text
from exmesh_graph.report.text import signed
from exmesh_graph.report.widgets import viewer_section

#: Beyond the spread of the seeds; `=` within it.
MARKS = {"better": "▲", "worse": "▼", "other": "≠", "same": "="}


def write_sweep(folder: Path, table: Mapping[str, Any], shown: SweepPictures | None = None) -> Path:
    """sweep.json, sweep.csv, sweep.md and the self-contained sweep.html with what is `shown`; returns the page."""
    replace_text(folder / "sweep.json", json.dumps(table, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    replace_text(folder / "sweep.csv", sweep_csv(table))
    replace_text(folder / "sweep.md", sweep_markdown(table))
    replace_text(folder / "sweep.html", render_sweep(table, shown))
    return folder / "sweep.html"


def sweep_csv(table: Mapping[str, Any]) -> str:
    """One line per variant; three columns per figure: mean, spread, difference to the base."""
    axes = list(dict.fromkeys(axis for row in table["variants"] for axis in row["settings"] if axis != "variant"))
    parts = ("mean", "spread", "difference")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["variant", *axes, "file", "state", "reason", "repeats", "seconds", "own seconds", "nodes", "shared"]
    writer.writerow([*head, *(f"{figure['label']} {part}" for figure in table["figures"] for part in parts)])
    for row in _rows(table):
        cells = [row["variant"], *(row["settings"].get(axis, "") for axis in axes), row["file"], row["state"],
                 row["reason"], len(row["repeats"]), row["seconds"]["mean"], row["seconds"]["own"], row["nodes"],
                 row["shared"], *(cell["entry"].get(part) for cell in row["cells"] for part in parts)]  # fmt: skip
        writer.writerow(["" if cell is None else cell for cell in cells])
    return out.getvalue()


def sweep_markdown(table: Mapping[str, Any]) -> str:
    """One line per variant: figures with a better direction (mean ± spread, mark against the base), its nodes' seconds.

    Marks are those of `table.verdict`; the base has none. What failed says why at the end.
    """
    figures = [figure for figure in table["figures"] if figure["better"]] or list(table["figures"])
    head = [f"{f['label']} [{f['unit']}]" if f["unit"] else f["label"] for f in figures]
    lines = [["variant", *head, "seconds"], ["---"] * (len(head) + 2)]
    for row in _rows(table, figures):
        marks = ["" if row["variant"] == "base" else MARKS.get(cell["verdict"], "") for cell in row["cells"]]
        seconds = f"{row['seconds']['mean']:.0f}" + (f"; {row['state']}: {row['reason']}" if row["reason"] else "")
        cells = [f"{cell['text']} {mark}".strip() for cell, mark in zip(row["cells"], marks, strict=True)]
        lines.append([f"`{row['label']}`", *cells, seconds])
    seeds = max((len(row["repeats"]) for row in table["variants"]), default=1)
    told = ["| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in line) + " |" for line in lines]
    told += ["", f"{seeds} seeds: mean ± sample standard deviation. ▲ better and ▼ worse than `base` by more than the"]
    told += ["spread of the paired differences, = within it. Seconds: one seed, all nodes, as they were when they ran."]
    return "\n".join(told) + "\n"


def render_sweep(table: Mapping[str, Any], shown: SweepPictures | None = None) -> str:
    """HTML text of a sweep's table (docs/variants.md) and of what its variants look like; works offline."""
    from markupsafe import Markup

    rows = _rows(table)
    tabs = []
    for number, figure in enumerate(table["figures"]):
        marks, differences = _marks(rows, number)
        if len({mark.y for mark in marks}) > 1:
            title = f"{figure['label']} ({figure['unit']})" if figure["unit"] else figure["label"]
            better = f"{figure['better']} is better" if figure["better"] else ""
            apart = bar_chart(differences, signed, name="differences", title="Difference to the base", width=470)
            tabs.append((figure["label"], Markup(scatter_chart(marks, title=title, y_label=better)), Markup(apart)))
    labels = {(row["file"], row["variant"]): row["label"] for row in rows}
    shown = shown or SweepPictures()
    models = [(_together(labels[key] for key in keys), model) for keys, model in shown.models]
    return page_of(
        __package__,
        "page.html",
        table=table,
        rows=rows,
        tabs=tabs,
        repeats=max(len(row["repeats"]) for row in rows),
        versus=Markup(versus_section(shown, labels, best_of(table))),
        viewer=Markup(viewer_section(models)),
        models_left_out=shown.models_left_out,
    )


def best_of(table: Mapping[str, Any]) -> tuple[tuple[str, str], str] | None:
    """((file, variant), label of the figure) of the best mean of the first figure that has a direction."""
    figure = next((figure for figure in table["figures"] if figure["better"] in ("higher", "lower")), None)
    if figure is None:
        return None
    means = {(row["file"], row["variant"]): row["figures"].get(figure["label"], {}).get("mean")
             for row in table["variants"]}  # fmt: skip
    known = {key: float(mean) for key, mean in means.items() if isinstance(mean, int | float)}
    best = max if figure["better"] == "higher" else min
    return (best(known, key=lambda key: known[key]), str(figure["label"])) if known else None


def _rows(table: Mapping[str, Any], figures: Iterable[Mapping[str, Any]] | None = None) -> list[dict[str, Any]]:
    """The variants, each with its label and a cell {entry, text, verdict} for each of the figures (None: all)."""
    several = len({row["file"] for row in table["variants"]}) > 1
    figures = list(table["figures"] if figures is None else figures)
    rows = []
    for row in table["variants"]:
        entries = [(figure, row["figures"].get(figure["label"], {})) for figure in figures]
        cells = [
            {"entry": entry, "text": text_of(entry), "verdict": verdict(figure, entry)} for figure, entry in entries
        ]
        rows.append({**row, "label": label_of(row, several), "cells": cells})
    return rows


def _together(labels: Iterable[str]) -> str:
    names = list(labels)
    return ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:3])} and {len(names) - 3} more"


def _marks(rows: list[dict[str, Any]], number: int) -> tuple[list[Mark], list[Mark]]:
    """A figure's values over seconds, and its differences to the base."""
    marks, differences = [], []
    for row in rows:
        cell = row["cells"][number]
        entry, kind = cell["entry"], "base" if row["variant"] == "base" else cell["verdict"]
        if not any(isinstance(value, bool | str) for value in entry.get("values") or [""]):
            marks.append(Mark(row["label"], entry["after_seconds"], entry["mean"], entry["spread"], kind))
            if "difference" in entry:
                differences.append(Mark(row["label"], entry["difference"], 0.0, entry["difference_spread"], kind))
    return marks, differences
