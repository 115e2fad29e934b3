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
    parts = [svg_start(width, height, "seconds per node")]
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
    axes = Axes((width, height), xs, ys, log=log, padding=(0.0, 0.14))
    parts = [svg_start(width, height, title), *axes.drawn(title, x_label)]
    if floor is not None:
        parts.append(axes.level(floor))
        py = axes.place(xs[0], floor)[1]
        parts.append(
            f'<text class="tick" x="{axes.right}" y="{py - 4:.1f}" text-anchor="end">'
            f"uninformed guess {number(float(floor))}</text>"
        )
    for index, (name, x_values, y_values) in enumerate(curves):
        placed = [axes.place(x, y) for x, y in zip(x_values, y_values, strict=True)]
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
                anchor = "start" if px < (axes.left + axes.right) / 2 else "end"
                parts.append(
                    f'<text class="tick" x="{px:.1f}" y="{py - 8:.1f}" text-anchor="{anchor}">{number(float(y))}</text>'
                )
    return "".join(parts) + "</svg>"


class Axes:
    """The frame of a chart: values to pixels, grid and ticks.

    `log` names the axes with a logarithmic scale, "x", "y" or "xy"; `padding` is the room beyond the values along x and
    y, as a share of their span; `inset` the room for labels at the left, top, right and bottom, in pixels.
    """

    def __init__(
        self,
        size: tuple[int, int],
        xs: Sequence[float],
        ys: Sequence[float],
        *,
        log: str = "",
        padding: tuple[float, float],
        inset: tuple[int, int, int, int] = (56, 26, 16, 34),
    ) -> None:
        self.left, self.top, self.right, self.bottom = inset[0], inset[1], size[0] - inset[2], size[1] - inset[3]
        self.size, self.log = size, log
        self.on_x, self.on_y = (math.log10 if axis in log else float for axis in "xy")
        self.x_low, self.x_high = _padded(self.on_x(min(xs)), self.on_x(max(xs)), padding[0])
        self.y_low, self.y_high = _padded(self.on_y(min(ys)), self.on_y(max(ys)), padding[1])

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of a pair of values."""
        return self._x(self.on_x(x)), self._y(self.on_y(y))

    def drawn(self, title: str, x_label: str, y_label: str = "") -> list[str]:
        """Title, grid, ticks and the names of the axes."""
        left, right, height = self.left, self.right, self.size[1]
        parts = [f'<text class="title" x="{left}" y="{self.top - 11}">{escape(title)}</text>']
        for y in (_log_ticks if "y" in self.log else _ticks)(self.y_low, self.y_high):
            py = self._y(self.on_y(y))
            parts.append(f'<line class="grid" x1="{left}" x2="{right}" y1="{py:.1f}" y2="{py:.1f}"/>')
            parts.append(f'<text class="tick" x="{left - 6}" y="{py + 4:.1f}" text-anchor="end">{_short(y)}</text>')
        for x in (_log_ticks if "x" in self.log else _ticks)(self.x_low, self.x_high):
            at = f'x="{self._x(self.on_x(x)):.1f}" y="{self.bottom + 15}"'
            parts.append(f'<text class="tick" {at} text-anchor="middle">{_short(x)}</text>')
        parts.append(f'<text class="axis" x="{right}" y="{height - 4}" text-anchor="end">{escape(x_label)}</text>')
        if y_label:
            parts.append(
                f'<text class="axis" x="{right}" y="{self.top - 11}" text-anchor="end">{escape(y_label)}</text>'
            )
        return parts

    def level(self, y: float) -> str:
        """A dashed line across at a value."""
        py = self._y(self.on_y(y))
        return f'<line class="floor" x1="{self.left}" x2="{self.right}" y1="{py:.1f}" y2="{py:.1f}"/>'

    def _x(self, scaled: float) -> float:
        return self.left + (self.right - self.left) * (scaled - self.x_low) / ((self.x_high - self.x_low) or 1.0)

    def _y(self, scaled: float) -> float:
        return self.bottom - (self.bottom - self.top) * (scaled - self.y_low) / ((self.y_high - self.y_low) or 1.0)


def thin(values: Sequence[float], at_most: int = 400) -> list[int]:
    """Indices of at most about `at_most` evenly spaced values, the first and the last included."""
    if len(values) <= at_most:
        return list(range(len(values)))
    step = (len(values) - 1) / (at_most - 1)
    return [round(index * step) for index in range(at_most)]


def svg_start(width: int, height: int, name: str) -> str:
    """The opening tag of a chart."""
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
        f'aria-label="{escape(name, quote=True)}">'
    )


def _padded(low: float, high: float, share: float) -> tuple[float, float]:
    pad = (share * (high - low) or 0.05 * abs(high) or 1.0) if share else 0.0
    return low - pad, high + pad


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
