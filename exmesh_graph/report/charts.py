"""Small inline SVG charts. Colours come from the page's style sheet through classes, so they follow its theme."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from exmesh_graph.report.text import number, seconds

_LETTER = 6.3  # width of a letter of a label
# places of a label beside its point, the best first
_BESIDE = ((8, 4, "start"), (-8, 4, "end"), (0, -10, "middle"), (0, 18, "middle"), (8, -8, "start"), (8, 16, "start"),
           (-8, -8, "end"), (-8, 16, "end"), (8, 28, "start"), (8, -20, "start"))  # fmt: skip

Rectangle = tuple[float, float, float, float]
"""left, top, right, bottom"""


@dataclass(frozen=True)
class Mark:
    """One entry of a chart: its place, half the length of its error bar, the class that colours it."""

    name: str
    x: float
    y: float = 0.0
    spread: float | None = None
    kind: str = ""


def bar_chart(
    bars: Sequence[Mark], write: Callable[[float], str], *, name: str, title: str = "", width: int = 520
) -> str:
    """Horizontal bars from zero to x, which `write` puts beside them, with whiskers of the marks' spreads."""
    if not bars:
        return ""
    left = min(190.0, 14 + _LETTER * max(len(bar.name) for bar in bars))
    top = 28 if title else 4
    height = top + 24 * len(bars) + 2
    reach = [bar.x + sign * (bar.spread or 0) for bar in bars for sign in (-1, 1)]
    at = _Scale([0.0, *reach], left + 8, width - 70)
    parts = [_svg_start(width, height, name), _text(4, 16, title, "title") if title else "",
             f'<path class="zero" d="M{at(0):.1f} {top - 4}V{height}"/>']  # fmt: skip
    for row, bar in enumerate(bars):
        y = top + 24 * row
        parts.append(f'<g class="mark {escape(bar.kind)}"><title>{escape(bar.name)}: {escape(write(bar.x))}</title>')
        parts.append(_text(left, y + 13, _cut(bar.name, int((left - 8) / _LETTER)), "label", "end"))
        parts.append(_bar(bar, at, y + 9, 14))
        tip = max(at(0), at(bar.x), at(bar.x + (bar.spread or 0)))
        parts.append(_text(tip + 6, y + 13, write(bar.x), "value") + "</g>")
    return "".join(parts) + "</svg>"


def gain_bar(bar: Mark, reach: float) -> str:
    """A bar for a cell of a table, from its middle, with a whisker; `reach` is what either half holds."""
    at = _Scale([-reach, reach], 3, 129)
    drawn = f'<g class="mark {bar.kind}">{_bar(bar, at, 8, 10)}<path class="grid" d="M66 0V16"/></g>'
    return f"{_svg_start(132, 16, bar.name)}{drawn}</svg>"


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
    axes = _Axes((width, height), xs, ys, log=log, padding=(0.0, 0.14))
    parts = [_svg_start(width, height, title), *axes.drawn(title, x_label)]
    if floor is not None:
        words = f"uninformed guess {number(float(floor))}"
        parts += [axes.level(floor), _text(axes.right, axes.y(floor) - 4, words, "tick", "end")]
    for index, (name, x_values, y_values) in enumerate(curves):
        placed = [(axes.x(x), axes.y(y)) for x, y in zip(x_values, y_values, strict=True)]
        path = " ".join(f"{px:.1f},{py:.1f}" for px, py in placed)
        parts.append(f'<polyline class="curve c{index % 4}" points="{path}"><title>{escape(name)}</title></polyline>')
        for (px, py), x, y in zip(placed, x_values, y_values, strict=True) if points else ():
            told = f"after {seconds(x)}" if x_label.startswith("seconds") else f"at {number(x)} {x_label}"
            tip = escape(f"{name}: {number(float(y))} {told}")
            parts.append(f'<circle class="point c{index % 4}" cx="{px:.1f}" cy="{py:.1f}" r="4">')
            parts.append(f"<title>{tip}</title></circle>")
            if y != floor:  # else the dashed line says it already
                anchor = "start" if px < (axes.left + axes.right) / 2 else "end"
                parts.append(_text(px, py - 8, number(float(y)), "tick", anchor))
    return "".join(parts) + "</svg>"


def scatter_chart(marks: Sequence[Mark], *, title: str, y_label: str, width: int = 620, height: int = 380) -> str:
    """Variants as labelled points, value over seconds; the base's value is a dashed line."""
    if not marks:
        return ""
    ys = [mark.y + sign * (mark.spread or 0) for mark in marks for sign in (-1, 1)]
    axes = _Axes((width, height), [mark.x for mark in marks], ys, padding=(0.12, 0.12), inset=(62, 27, 18, 38))
    parts = [_svg_start(width, height, f"{title} over seconds"), *axes.drawn(title, "seconds until scored", y_label)]
    parts += [axes.level(mark.y) for mark in marks if mark.kind == "base"][:1]
    points = [(axes.x(mark.x), axes.y(mark.y)) for mark in marks]
    labels = _labels([mark.name for mark in marks], points, (axes.left, axes.top, axes.right, axes.bottom))
    for mark, (px, py), (lx, ly, anchor) in zip(marks, points, labels, strict=True):
        spread = f" ± {number(mark.spread)}" if mark.spread else ""
        tip = escape(f"{mark.name}: {number(mark.y)}{spread} after {seconds(mark.x)}")
        parts.append(f'<g class="mark {escape(mark.kind)}"><title>{tip}</title>')
        if mark.spread:
            low, high = axes.y(mark.y - mark.spread), axes.y(mark.y + mark.spread)
            ends = f"M{px - 4:.1f} {low:.1f}h8M{px - 4:.1f} {high:.1f}h8"
            parts.append(f'<path class="whisker" d="M{px:.1f} {low:.1f}V{high:.1f}{ends}"/>')
        parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4.5"/>{_text(lx, ly, mark.name, "label", anchor)}</g>')
    return "".join(parts) + "</svg>"


def thin(values: Sequence[float], at_most: int = 400) -> list[int]:
    """Indices of at most about `at_most` evenly spaced values, the first and the last included."""
    if len(values) <= at_most:
        return list(range(len(values)))
    step = (len(values) - 1) / (at_most - 1)
    return [round(index * step) for index in range(at_most)]


class _Scale:
    """Values to pixels: `start` for the least, `end` for the largest; `padding` beyond them, a share of their span."""

    def __init__(
        self, values: Sequence[float], start: float, end: float, *, log: bool = False, padding: float = 0.0
    ) -> None:
        self.log, self.start, self.end = log, start, end
        low, high = self._on(min(values)), self._on(max(values))
        pad = (padding * (high - low) or 0.05 * abs(high) or 1.0) if padding else 0.0
        self.low, self.high = low - pad, high + pad

    def __call__(self, value: float) -> float:
        return self.start + (self.end - self.start) * (self._on(value) - self.low) / ((self.high - self.low) or 1.0)

    def _on(self, value: float) -> float:
        return math.log10(value) if self.log else float(value)

    def ticks(self) -> list[float]:
        """About four round values; on a logarithmic scale at most six of 1, 2, 5 times a power of ten."""
        low, high, span = self.low, self.high, self.high - self.low
        if not self.log:
            if span <= 0:
                return [low]
            step = 10.0 ** int(f"{span / 4:e}".split("e")[1])
            step *= next(factor for factor in (1, 2, 5, 10) if span / (step * factor) <= 5)
            first = int(low / step) - 1
            return [k * step for k in range(first, first + 12) if low - 1e-9 * span <= k * step <= high + 1e-9 * span]
        decades = range(math.floor(low), math.ceil(high) + 1)
        for factors in ((1, 2, 5), (1, 3), (1,)):
            ticks = [factor * 10.0**k for k in decades for factor in factors]
            ticks = [tick for tick in ticks if low - 1e-9 <= math.log10(tick) <= high + 1e-9]
            if len(ticks) <= 6:
                return ticks
        return ticks[:: -(-len(ticks) // 6)]


class _Axes:
    """The frame of a chart: a scale along each side, grid and ticks.

    `log` as for `line_chart`; `inset` is the room for labels at the left, top, right and bottom, in pixels.
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
        self.x = _Scale(xs, self.left, self.right, log="x" in log, padding=padding[0])
        self.y = _Scale(ys, self.bottom, self.top, log="y" in log, padding=padding[1])
        self.foot = size[1] - 4

    def drawn(self, title: str, x_label: str, y_label: str = "") -> list[str]:
        """Title, grid, ticks and the names of the axes."""
        parts = [_text(self.left, self.top - 11, title, "title")]
        for y in self.y.ticks():
            parts += [self.level(y, "grid"), _text(self.left - 6, self.y(y) + 4, _short(y), "tick", "end")]
        parts += [_text(self.x(x), self.bottom + 15, _short(x), "tick", "middle") for x in self.x.ticks()]
        parts.append(_text(self.right, self.foot, x_label, "axis", "end"))
        return [*parts, _text(self.right, self.top - 11, y_label, "axis", "end")] if y_label else parts

    def level(self, y: float, kind: str = "floor") -> str:
        """A line across at a value, dashed unless it is of the grid."""
        return f'<path class="{kind}" d="M{self.left} {self.y(y):.1f}H{self.right}"/>'


def _svg_start(width: int, height: int, name: str) -> str:
    """The opening tag of a chart."""
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'<svg {size} role="img" aria-label="{escape(name, quote=True)}">'


def _text(x: float, y: float, words: str, kind: str, anchor: str = "start") -> str:
    at = f'x="{x:.1f}" y="{y:.1f}"' + (f' text-anchor="{anchor}"' if anchor != "start" else "")
    return f'<text class="{kind}" {at}>{escape(words)}</text>'


def _bar(bar: Mark, at: _Scale, y: float, height: float) -> str:
    """A bar about the line `y` from zero to the mark's x, and its whisker."""
    left, right = sorted((at(0.0), at(bar.x)))
    drawn = (
        f'<rect x="{left:.1f}" y="{y - height / 2:g}" width="{max(1.5, right - left):.1f}" height="{height}" rx="2"/>'
    )
    if not bar.spread:
        return drawn
    low, high = at(bar.x - bar.spread), at(bar.x + bar.spread)
    ends = f"M{low:.1f} {y - 4}v8M{high:.1f} {y - 4}v8"
    return f'{drawn}<path class="whisker" d="M{low:.1f} {y}H{high:.1f}{ends}"/>'


def _labels(
    names: Sequence[str], points: Sequence[tuple[float, float]], frame: Rectangle
) -> list[tuple[float, float, str]]:
    """(x, y, anchor) of every label, where it covers least of other labels and points."""
    left, top, right, bottom = frame
    taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in points]
    chosen = []
    for name, (x, y) in zip(names, points, strict=True):
        wide = _LETTER * len(name)
        ranked = []
        for rank, (dx, dy, anchor) in enumerate(_BESIDE):
            start = x + dx - wide * {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor]
            box = (start, y + dy - 11, start + wide, y + dy + 3)
            outside = sum(max(0.0, over) for over in (left - box[0], box[2] - right, top - box[1], box[3] - bottom))
            cost = 20 * outside + sum(_overlap(box, other) for other in taken)
            ranked.append((cost, rank, box, (x + dx, y + dy, anchor)))
        _, _, box, place = min(ranked)
        taken.append(box)
        chosen.append(place)
    return chosen


def _overlap(a: Rectangle, b: Rectangle) -> float:
    return max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


def _short(value: float) -> str:
    return f"{value / 1000:g}k" if abs(value) >= 10000 else f"{value:.6g}"
