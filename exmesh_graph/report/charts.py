"""Small inline SVG charts. Colours come from the page's style sheet through classes, so they follow its theme."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from exmesh_graph.report.text import number, seconds


def bar_chart(rows: Sequence[tuple[str, float, str]], *, width: int = 520) -> str:
    """Horizontal bars of (label, seconds, state), in the given order."""
    label_width, row_height = 170, 22
    longest = max((value for _, value, _ in rows), default=0.0) or 1.0
    room = width - label_width - 76
    height = row_height * len(rows) + 8
    parts = [_open(width, height, "seconds per node")]
    for index, (label, value, state) in enumerate(rows):
        y = 4 + index * row_height
        length = max(1.5, room * value / longest)
        parts.append(
            f'<text class="label" x="{label_width - 8}" y="{y + 15}" text-anchor="end">{escape(label)}</text>'
            f'<rect class="bar {escape(state)}" x="{label_width}" y="{y + 3}" width="{length:.1f}" '
            f'height="{row_height - 7}" rx="2"/>'
            f'<text class="value" x="{label_width + length + 6:.1f}" y="{y + 15}">{escape(seconds(value))}</text>'
        )
    return "".join(parts) + "</svg>"


def line_chart(
    curves: Sequence[tuple[str, Sequence[float], Sequence[float]]],
    *,
    title: str,
    x_label: str,
    floor: float | None = None,
    points: bool = False,
    log: str = "",
    width: int = 340,
    height: int = 200,
) -> str:
    """Curves (name, x, y) in one frame; `floor` is a dashed line, `points` marks and labels every point.

    `log` names the axes with a logarithmic scale, "x", "y" or "xy"; all values on them are above 0.
    """
    xs = [x for _, x_values, _ in curves for x in x_values]
    ys = [y for _, _, y_values in curves for y in y_values] + ([floor] if floor is not None else [])
    if not xs or not ys:
        return ""
    on_x, on_y = (math.log10 if axis in log else float for axis in "xy")
    x_low, x_high = on_x(min(xs)), on_x(max(xs))
    y_low, y_high = on_y(min(ys)), on_y(max(ys))
    x_span = (x_high - x_low) or 1.0
    pad = 0.14 * (y_high - y_low) or 0.05 * abs(y_high) or 1.0
    y_low, y_high = y_low - pad, y_high + pad
    left, top, right, bottom = 56, 26, width - 16, height - 34

    def place(x: float, y: float) -> tuple[float, float]:
        return (
            left + (right - left) * (on_x(x) - x_low) / x_span,
            bottom - (bottom - top) * (on_y(y) - y_low) / (y_high - y_low),
        )

    x_ticks = _log_ticks(x_low, x_high) if "x" in log else _ticks(x_low, x_high)
    y_ticks = _log_ticks(y_low, y_high) if "y" in log else _ticks(y_low, y_high)

    parts = [_open(width, height, title), f'<text class="title" x="{left}" y="15">{escape(title)}</text>']
    for y in y_ticks:
        py = place(xs[0], y)[1]
        parts.append(f'<line class="grid" x1="{left}" x2="{right}" y1="{py:.1f}" y2="{py:.1f}"/>')
        parts.append(f'<text class="tick" x="{left - 6}" y="{py + 4:.1f}" text-anchor="end">{_short(y)}</text>')
    for x in x_ticks:
        px = place(x, ys[0])[0]
        parts.append(f'<text class="tick" x="{px:.1f}" y="{bottom + 15}" text-anchor="middle">{_short(x)}</text>')
    parts.append(f'<text class="axis" x="{right}" y="{height - 4}" text-anchor="end">{escape(x_label)}</text>')
    if floor is not None:
        py = place(xs[0], floor)[1]
        parts.append(f'<line class="floor" x1="{left}" x2="{right}" y1="{py:.1f}" y2="{py:.1f}"/>')
        parts.append(
            f'<text class="tick" x="{right}" y="{py - 4:.1f}" text-anchor="end">'
            f"uninformed guess {number(float(floor))}</text>"
        )
    for index, (name, x_values, y_values) in enumerate(curves):
        placed = [place(x, y) for x, y in zip(x_values, y_values, strict=True)]
        path = " ".join(f"{px:.1f},{py:.1f}" for px, py in placed)
        parts.append(f'<polyline class="curve c{index % 4}" points="{path}"><title>{escape(name)}</title></polyline>')
        if points:
            for (px, py), x, y in zip(placed, x_values, y_values, strict=True):
                tip = f"{name}: {number(float(y))} " + (
                    f"after {seconds(x)}" if x_label.startswith("seconds") else f"at {number(x)} {x_label}"
                )
                parts.append(
                    f'<circle class="point c{index % 4}" cx="{px:.1f}" cy="{py:.1f}" r="4">'
                    f"<title>{escape(tip)}</title></circle>"
                )
                if y == floor:
                    continue  # the dashed line says it already
                anchor = "start" if px < (left + right) / 2 else "end"
                parts.append(
                    f'<text class="tick" x="{px:.1f}" y="{py - 8:.1f}" text-anchor="{anchor}">{number(float(y))}</text>'
                )
    return "".join(parts) + "</svg>"


def thin(values: Sequence[float], at_most: int = 400) -> list[int]:
    """Indices of at most about `at_most` evenly spaced values, the first and the last included."""
    if len(values) <= at_most:
        return list(range(len(values)))
    step = (len(values) - 1) / (at_most - 1)
    return [round(index * step) for index in range(at_most)]


def _open(width: int, height: int, name: str) -> str:
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
        f'aria-label="{escape(name, quote=True)}">'
    )


def _ticks(low: float, high: float) -> list[float]:
    """About four round values in [low, high]."""
    span = high - low
    if span <= 0:
        return [low]
    step = 10.0 ** _exponent(span / 4)
    step *= next(factor for factor in (1, 2, 5, 10) if span / (step * factor) <= 5)
    first = int(low / step) - 1
    return [k * step for k in range(first, first + 12) if low - 1e-9 * span <= k * step <= high + 1e-9 * span]


def _log_ticks(low: float, high: float) -> list[float]:
    """At most six values 1, 2, 5 times a power of ten between 10^low and 10^high."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    for factors in ((1, 2, 5), (1, 3), (1,)):
        ticks = [factor * 10.0**k for k in decades for factor in factors]
        ticks = [tick for tick in ticks if low - 1e-9 <= math.log10(tick) <= high + 1e-9]
        if len(ticks) <= 6:
            return ticks
    return ticks[:: -(-len(ticks) // 6)]


def _exponent(value: float) -> int:
    return int(f"{value:e}".split("e")[1])


def _short(value: float) -> str:
    if abs(value) >= 10000:
        return f"{value / 1000:g}k"
    return f"{value:.6g}"
