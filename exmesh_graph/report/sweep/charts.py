"""Two charts of a sweep: a figure over the seconds it cost, and its differences to the base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from exmesh_graph.report.charts import Axes, svg_start
from exmesh_graph.report.text import number, seconds, signed

_LETTER = 6.3  # width of a letter of a label


@dataclass(frozen=True)
class Mark:
    """One variant in a chart: place, half length of its error bar, class for its colour."""

    name: str
    x: float
    y: float
    spread: float | None = None
    kind: str = ""


def scatter_chart(marks: Sequence[Mark], *, title: str, y_label: str, width: int = 620, height: int = 380) -> str:
    """Variants as labelled points, value over seconds; the base's value is a dashed line."""
    if not marks:
        return ""
    ys = [y for mark in marks for y in (mark.y - (mark.spread or 0), mark.y + (mark.spread or 0))]
    axes = Axes((width, height), [mark.x for mark in marks], ys, padding=(0.12, 0.12), inset=(62, 27, 18, 38))
    parts = [svg_start(width, height, f"{title} over seconds"), *axes.drawn(title, "seconds until scored", y_label)]
    base = next((mark for mark in marks if mark.kind == "base"), None)
    if base is not None:
        parts.append(axes.level(base.y))
    points = [axes.place(mark.x, mark.y) for mark in marks]
    labels = _labels([mark.name for mark in marks], points, (axes.left, axes.top, axes.right, axes.bottom))
    for mark, (px, py), (lx, ly, anchor) in zip(marks, points, labels, strict=True):
        tip = (
            f"{mark.name}: {number(mark.y)}{f' ± {number(mark.spread)}' if mark.spread else ''} after {seconds(mark.x)}"
        )
        parts.append(f'<g class="mark {escape(mark.kind)}"><title>{escape(tip)}</title>')
        if mark.spread:
            low, high = (axes.place(mark.x, mark.y + sign * mark.spread)[1] for sign in (-1, 1))
            parts.append(
                f'<path class="whisker" d="M{px:.1f} {low:.1f}V{high:.1f}'
                f'M{px - 4:.1f} {low:.1f}h8M{px - 4:.1f} {high:.1f}h8"/>'
            )
        parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4.5"/>')
        parts.append(
            f'<text class="label" x="{lx:.1f}" y="{ly:.1f}" text-anchor="{anchor}">{escape(mark.name)}</text></g>'
        )
    return "".join(parts) + "</svg>"


def difference_chart(marks: Sequence[Mark], *, title: str, width: int = 470) -> str:
    """Horizontal bars of (name, x = difference to the base), with the spread of the difference as whisker."""
    rows = [mark for mark in marks if mark.kind != "base"]
    if not rows:
        return ""
    label_width = min(190.0, 14 + _LETTER * max(len(mark.name) for mark in rows))
    room, height = width - label_width - 70, 30 + 24 * len(rows)
    low = min(0.0, *(mark.x - (mark.spread or 0) for mark in rows))
    high = max(0.0, *(mark.x + (mark.spread or 0) for mark in rows))
    span = (high - low) or 1.0

    def at(value: float) -> float:
        return label_width + 8 + room * (value - low) / span

    zero = at(0.0)
    parts = [svg_start(width, height, title), f'<text class="title" x="4" y="16">{escape(title)}</text>',
             f'<line class="zero" x1="{zero:.1f}" x2="{zero:.1f}" y1="24" y2="{height}"/>']  # fmt: skip
    for index, mark in enumerate(rows):
        y = 28 + 24 * index
        x, end = sorted((zero, at(mark.x)))
        shown = _cut(mark.name, int((label_width - 8) / _LETTER))
        parts.append(
            f'<g class="mark {escape(mark.kind)}"><title>{escape(mark.name)}: {signed(mark.x)}</title>'
            f'<text class="label" x="{label_width}" y="{y + 13}" text-anchor="end">{escape(shown)}</text>'
            f'<rect x="{x:.1f}" y="{y + 2}" width="{max(1.0, end - x):.1f}" height="14" rx="2"/>'
        )
        tip = max(end, at(mark.x + (mark.spread or 0)))
        if mark.spread:
            a, b = at(mark.x - mark.spread), at(mark.x + mark.spread)
            parts.append(f'<path class="whisker" d="M{a:.1f} {y + 9}H{b:.1f}M{a:.1f} {y + 5}v8M{b:.1f} {y + 5}v8"/>')
        parts.append(f'<text class="value" x="{tip + 6:.1f}" y="{y + 13}">{signed(mark.x)}</text></g>')
    return "".join(parts) + "</svg>"


def _labels(
    names: Sequence[str], points: Sequence[tuple[float, float]], frame: tuple[float, float, float, float]
) -> list[tuple[float, float, str]]:
    """A place for every label beside its point, where it covers least of other labels and points."""
    left, top, right, bottom = frame
    taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in points]
    chosen = []
    for name, (x, y) in zip(names, points, strict=True):
        wide = _LETTER * len(name)
        best: tuple[float, tuple[float, float, str], tuple[float, float, float, float]] | None = None
        for dx, dy, anchor in (
            (8, 4, "start"), (-8, 4, "end"), (0, -10, "middle"), (0, 18, "middle"),
            (8, -8, "start"), (8, 16, "start"), (-8, -8, "end"), (-8, 16, "end"), (8, 28, "start"), (8, -20, "start"),
        ):  # fmt: skip
            start = x + dx - {"start": 0.0, "middle": wide / 2, "end": wide}[anchor]
            box = (start, y + dy - 11, start + wide, y + dy + 3)
            outside = (
                max(0.0, left - box[0]) + max(0.0, box[2] - right) + max(0.0, top - box[1]) + max(0.0, box[3] - bottom)
            )
            cost = 20 * outside + sum(_overlap(box, other) for other in taken)
            if best is None or cost < best[0]:
                best = cost, (x + dx, y + dy, anchor), box
            if cost == 0:
                break
        assert best is not None
        taken.append(best[2])
        chosen.append(best[1])
    return chosen


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    return max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
