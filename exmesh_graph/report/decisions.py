"""What was modelled and why: the rows of `Metrics.values["decisions"]` with a bar for each gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from exmesh_graph.report.text import number

WIDTH, HEIGHT = 132, 16


@dataclass(frozen=True)
class Row:
    """One decision as the page shows it; texts are empty where nothing was measured."""

    name: str
    value: str
    gain: str
    cost: str
    measured: str
    reason: str
    bar: str


def decision_tables(metrics: Mapping[str, Mapping[str, Any]]) -> dict[str, list[Row]]:
    """The tables by `node.port`, for all figures that hold a list named `decisions`."""
    return {name: _rows(values["decisions"]) for name, values in metrics.items() if _is_table(values)}


def _is_table(values: Mapping[str, Any]) -> bool:
    rows = values.get("decisions")
    return bool(rows) and isinstance(rows, list) and all(isinstance(row, Mapping) and "name" in row for row in rows)


def _rows(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    reach = max([abs(row["gain"]) + (row.get("error") or 0) for row in rows if row.get("gain") is not None] + [0.1])
    made = []
    for row in rows:
        gain, error = row.get("gain"), row.get("error")
        shown = "" if gain is None else f"{gain:+.2f}" + ("" if error is None else f" ± {error:.2f}") + " dB"
        cost, ratio = row.get("cost"), row.get("seconds_ratio")
        on = bool(row.get("value")) and gain is not None and gain > 0
        made.append(
            Row(
                name=str(row["name"]),
                value=number(row.get("value")),
                gain=shown,
                cost="" if cost is None else f"{100 * (cost - 1):+.0f} %",
                measured="" if ratio is None else f"{100 * (ratio - 1):+.0f} %",
                reason=str(row.get("reason") or ""),
                bar="" if gain is None else _bar(gain, error or 0.0, reach, on),
            )
        )
    return made


def _bar(gain: float, error: float, reach: float, on: bool) -> str:
    """A bar from zero (the middle) to the gain, with a whisker of one standard error either way."""
    middle, scale, y = WIDTH / 2, (WIDTH / 2 - 3) / reach, HEIGHT / 2
    end, low, high = (middle + scale * max(-reach, min(reach, value)) for value in (gain, gain - error, gain + error))
    left, right = min(middle, end), max(middle, end)
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img" aria-label="{gain:+.2f} dB">'
        f'<rect class="bar{"" if on else " hit"}" x="{left:.1f}" y="3" width="{max(right - left, 1):.1f}" '
        f'height="{HEIGHT - 6}"/>'
        f'<line class="whisker" x1="{low:.1f}" x2="{high:.1f}" y1="{y}" y2="{y}"/>'
        f'<line class="grid" x1="{middle}" x2="{middle}" y1="0" y2="{HEIGHT}"/></svg>'
    )
