"""The cells that charts take on the packer's grid, with their share of the padding, in several orientations.

Bitmaps come from the charts' outlines alone (`winding`, `near`): cheap at any number of faces.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from exmesh_graph.types.edges import edges_of

_TURNS = ((16, 8), (64, 4))  # (rank, turns): how many of the largest charts are tried in how many orientations


@dataclass(frozen=True, eq=False)
class Items:
    """Charts in orientations, sorted by chart.

    chart  int64 [I]; turn complex [I], the rotation; low complex [I], the corner of its box after turning, in cells
    masks  bool [h, w] each: the marked cells; None for one that is larger than the square
    rim    cells that a mask is wider than its chart, on each side
    least  cells that all charts need
    """

    chart: np.ndarray
    turn: np.ndarray
    low: np.ndarray
    masks: list[np.ndarray | None]
    rim: int
    least: float
    _cells: dict[int, np.ndarray] = field(default_factory=dict)

    def cells(self, item: int) -> np.ndarray:
        """int32 [n, 2], the marked cells (row, column) in a mixed order: a place that is taken shows so sooner."""
        if item not in self._cells:
            mask = self.masks[item]
            assert mask is not None
            cells = np.argwhere(mask).astype(np.int32)
            self._cells[item] = cells[np.random.default_rng(0).permutation(len(cells))]
        return self._cells[item]


class Outlines:
    """The border edges of flat charts."""

    def __init__(self, points: np.ndarray, corners: np.ndarray, chart: np.ndarray) -> None:
        """points complex [T], rows downwards; corners int [F, 3] into it; chart int [F]."""
        edges = edges_of(corners)
        half = edges.halfedges[edges.count == 1, 0]
        owner = chart[half // 3]
        half = half[np.argsort(owner, kind="stable")]
        face, k = half // 3, half % 3
        self.tail, self.head = points[corners[face, k]], points[corners[face, (k + 1) % 3]]
        self.charts = int(chart.max()) + 1
        self.first = np.searchsorted(chart[face], np.arange(self.charts + 1))
        size = np.maximum.reduceat(np.maximum(self.tail.real, self.tail.imag), self.first[:-1])
        self.rank = np.empty(self.charts, np.int64)
        self.rank[np.argsort(-size, kind="stable")] = np.arange(self.charts)

    def items(self, scale: float, side: int, margin: float, turned: bool = True) -> Items | None:
        """All charts at `scale` cells per unit, the large ones in several orientations, drawn side by side on a sheet.

        None when a chart is larger than the square.
        """
        turns = np.ones(self.charts, np.int64)
        for rank, many in reversed(_TURNS) if turned else ():
            turns[self.rank < rank] = many
        chart = np.repeat(np.arange(self.charts), turns)
        step = np.arange(len(chart)) - np.repeat(np.cumsum(turns) - turns, turns)
        turn = np.exp(2j * np.pi * step / turns[chart])
        count = np.diff(self.first)[chart]
        item = np.repeat(np.arange(len(chart)), count)
        start = np.cumsum(count) - count
        edge = np.arange(len(item)) - start[item] + self.first[chart[item]]
        tail, head = self.tail[edge] * turn[item] * scale, self.head[edge] * turn[item] * scale
        low = np.minimum.reduceat(tail.real, start) + 1j * np.minimum.reduceat(tail.imag, start)
        high = np.maximum.reduceat(tail.real, start) + 1j * np.maximum.reduceat(tail.imag, start)
        rim = int(np.ceil(margin - 0.5))
        width = np.ceil((high - low).real).astype(np.int64) + 2 * rim
        height = np.ceil((high - low).imag).astype(np.int64) + 2 * rim
        fits = np.maximum(width, height) <= side
        if len(np.unique(chart[fits])) < self.charts:
            return None

        left, top, shape = shelves(width, height, int(np.ceil(margin)) + 1)
        shift = left + 1j * top - low + (rim - 0.5) * (1 + 1j)  # cell centres lie at + 0.5
        tail, head = tail + shift[item], head + shift[item]
        lines = (tail.real, tail.imag, head.real, head.imag)
        marked = (winding(*lines, shape) != 0) | near(*lines, shape, margin)
        masks = [
            marked[y : y + h, x : x + w] if ok else None
            for x, y, w, h, ok in zip(*(a.tolist() for a in (left, top, width, height, fits)), strict=True)
        ]
        least = np.full(self.charts, np.inf)
        np.minimum.at(least, chart, [np.inf if mask is None else mask.sum() for mask in masks])
        return Items(chart, turn, low, masks, rim, float(least.sum()))


def shelves(width: np.ndarray, height: np.ndarray, gap: int) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """(left, top, (H, W) of the sheet) of boxes that stand in rows of about one height, `gap` apart; int64 [n] each."""
    sheet = max(int(width.max()), int(np.sqrt(((width + gap) * (height + gap)).sum()) * 1.1) + 1)
    left, top = np.zeros(len(width), np.int64), np.zeros(len(width), np.int64)
    across = row = tallest = 0
    for k in np.argsort(-height, kind="stable").tolist():
        if across + int(width[k]) > sheet:
            across, row, tallest = 0, row + tallest, 0
        left[k], top[k] = across, row
        across, tallest = across + int(width[k]) + gap, max(tallest, int(height[k]) + gap)
    return left, top, (row + tallest, sheet + gap)


def winding(x0: np.ndarray, y0: np.ndarray, x1: np.ndarray, y1: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """int [H, W], how often the directed edges [E] go around each cell centre (row i, column j at x = j, y = i).

    1 inside one chart, 2 or more where a chart lies over itself; the sign is the sense of rotation. By a half-open
    rule: a centre on a common edge counts once.
    """
    height, width = shape
    down = y1 >= y0
    top, bottom = np.where(down, y0, y1), np.where(down, y1, y0)
    first = np.clip(np.ceil(top), 0, height).astype(np.int64)
    last = np.clip(np.ceil(bottom), 0, height).astype(np.int64)
    rows = last - first
    edge = np.repeat(np.arange(len(x0)), rows)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(rows) - rows, rows) + first[edge]
    slope = (x1 - x0)[edge] / np.where(y1 == y0, 1.0, y1 - y0)[edge]
    column = np.clip(np.ceil(x0[edge] + (row - y0[edge]) * slope), 0, width).astype(np.int64)
    change = np.bincount(row * (width + 1) + column, np.where(down, 1.0, -1.0)[edge], height * (width + 1))
    return np.cumsum(np.rint(change).astype(np.int32).reshape(height, width + 1), axis=1)[:, :width]


def near(
    x0: np.ndarray, y0: np.ndarray, x1: np.ndarray, y1: np.ndarray, shape: tuple[int, int], margin: float
) -> np.ndarray:
    """bool [H, W], cell centres within `margin` of an edge."""
    height, width = shape
    left = np.clip(np.ceil(np.minimum(x0, x1) - margin), 0, width).astype(np.int64)
    right = np.clip(np.floor(np.maximum(x0, x1) + margin) + 1, 0, width).astype(np.int64)
    top = np.clip(np.ceil(np.minimum(y0, y1) - margin), 0, height).astype(np.int64)
    bottom = np.clip(np.floor(np.maximum(y0, y1) + margin) + 1, 0, height).astype(np.int64)
    columns, rows = np.maximum(right - left, 0), np.maximum(bottom - top, 0)
    cells = columns * rows
    edge = np.repeat(np.arange(len(x0)), cells)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(cells) - cells, cells)
    column, row = left[edge] + within % columns[edge], top[edge] + within // columns[edge]
    dx, dy = (x1 - x0)[edge], (y1 - y0)[edge]
    px, py = column - x0[edge], row - y0[edge]
    length2 = dx * dx + dy * dy
    t = np.clip((px * dx + py * dy) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    close = (px - t * dx) ** 2 + (py - t * dy) ** 2 <= margin * margin
    marked = np.zeros(height * width, bool)
    marked[(row * width + column)[close]] = True
    return marked.reshape(height, width)
