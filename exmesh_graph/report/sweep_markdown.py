"""The table of a sweep in Markdown, for a document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from exmesh_graph.report.sweep_page import label_of, text_of, verdict

#: Beyond the spread of the seeds; `=` within it.
MARKS = {"better": "▲", "worse": "▼", "other": "≠", "same": "="}


def sweep_markdown(table: Mapping[str, Any]) -> str:
    """One line per variant: figures with a better direction (mean ± spread, mark against the base), its nodes' seconds.

    Marks are those of `sweep_page.verdict`; the base has none. What failed says why at the end.
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
