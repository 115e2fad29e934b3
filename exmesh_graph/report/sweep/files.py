"""The files of a sweep: its table as JSON, CSV and Markdown, its page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exmesh_graph.report.sweep.page import render_sweep
from exmesh_graph.report.sweep.pictures import SweepPictures
from exmesh_graph.report.sweep.table import label_of, text_of, verdict
from exmesh_graph.report.templates import replace_text

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
    labels = [figure["label"] for figure in table["figures"]]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["variant", *axes, "file", "state", "reason", "repeats", "seconds", "own seconds", "nodes", "shared"]
    writer.writerow([*head, *(f"{label} {part}" for label in labels for part in ("mean", "spread", "difference"))])
    for row in table["variants"]:
        cells = [row["variant"], *(row["settings"].get(axis, "") for axis in axes), row["file"], row["state"],
                 row["reason"], len(row["repeats"]), row["seconds"]["mean"], row["seconds"]["own"], row["nodes"],
                 row["shared"]]  # fmt: skip
        for label in labels:
            figure = row["figures"].get(label, {})
            cells += [figure.get(part) for part in ("mean", "spread", "difference")]
        writer.writerow(["" if cell is None else cell for cell in cells])
    return out.getvalue()


def sweep_markdown(table: Mapping[str, Any]) -> str:
    """One line per variant: figures with a better direction (mean ± spread, mark against the base), its nodes' seconds.

    Marks are those of `table.verdict`; the base has none. What failed says why at the end.
    """
    figures = [figure for figure in table["figures"] if figure["better"]] or list(table["figures"])
    rows, several = table["variants"], len({row["file"] for row in table["variants"]}) > 1
    head = [f"{f['label']} [{f['unit']}]" if f["unit"] else f["label"] for f in figures]
    lines = [_line(["variant", *head, "seconds"]), _line(["---"] * (len(head) + 2))]
    for row in rows:
        cells = []
        for figure in figures:
            entry = row["figures"].get(figure["label"], {})
            mark = "" if row["variant"] == "base" else MARKS.get(verdict(figure, entry), "")
            cells.append(f"{text_of(entry)} {mark}".strip())
        seconds = f"{row['seconds']['mean']:.0f}"
        if row["reason"]:
            seconds += f"; {row['state']}: {row['reason']}"
        lines.append(_line([f"`{label_of(row, several)}`", *cells, seconds]))
    seeds = max((len(row["repeats"]) for row in rows), default=1)
    lines += ["", f"{seeds} seeds: mean ± sample standard deviation. ▲ better and ▼ worse than `base` by more than the"]
    lines += [
        "spread of the paired differences, = within it. Seconds: one seed, all nodes, as they were when they ran."
    ]
    return "\n".join(lines) + "\n"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"
