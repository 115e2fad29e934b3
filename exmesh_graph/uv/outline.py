"""Bitmaps of flat charts from their outlines alone: cheap at any number of faces."""

from __future__ import annotations

import numpy as np


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
    found = np.zeros(height * width, bool)
    found[(row * width + column)[close]] = True
    return found.reshape(height, width)
