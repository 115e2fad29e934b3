"""Packing of flat charts into a square: bitmaps on a coarse grid, true rotations only, padding exact.

A chart marks every cell whose centre is within padding / 2 + sqrt(1/2) cells of it. Where two charts come closer than
the padding, the cell around the middle of the gap is marked by both; so charts whose marks do not meet keep the
padding. The largest scale on a ladder of 3 % steps that fits is taken.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import components
from exmesh_graph.uv.raster import rasterize_atlas

_CELLS = 256  # of the grid along a side, at most
_STEP, _STEPS = 0.97, 160
_FULL = 0.8  # part of the square that charts and their padding can usually fill
_ANGLES = 18
_TURNED = 64  # the largest charts, which are tried in all four orientations


def pack(flat: np.ndarray, corners: np.ndarray, texture_size: int, padding: int) -> np.ndarray:
    """Place charts so that they share no texel and stay `padding` texels apart.

    flat     float [T, 2], coordinates of flat charts in one common unit, orientation positive
    corners  int [F, 3], indices into `flat`; charts are its edge-connected components
    Returns float64 [T, 2] in [0, 1]. Raises GeometryError when even tiny charts do not fit.
    """
    chart = components(corners)
    n = int(chart.max()) + 1
    owner = np.full(len(flat), -1, np.int64)
    owner[corners.reshape(-1)] = np.repeat(chart, 3)
    used = np.flatnonzero(owner >= 0)
    local, extent = _upright(flat[used], owner[used], n)
    corner_local = np.full(len(flat), -1, np.int64)
    corner_local[used] = np.arange(len(used))
    faces = corner_local[corners]

    cell = max(1, -(-texture_size // _CELLS))  # texels
    side = texture_size // cell
    margin = 0.5 * padding / cell + 0.5**0.5
    a, b, c = (local[faces[:, k]] for k in range(3))
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
    largest = side / np.sqrt(area)  # cells per unit

    @cache
    def attempt(step: int) -> tuple[float, np.ndarray, np.ndarray, int] | None:
        scale = largest * _STEP**step
        masks = _masks(local, faces, chart, extent, scale, side, margin)
        placed = None if masks is None else _place(masks, side)
        return None if placed is None else (scale, *placed, int(np.ceil(margin - 0.5)))

    def is_full(step: int) -> bool:
        masks = _masks(local, faces, chart, extent, largest * _STEP**step, side, margin)
        return masks is None or sum(int(mask.sum()) for mask in masks) > _FULL * side * side

    # Marks grow with the scale: find the step at which they fill the usual part of the square, and search from there.
    low, high = 0, _STEPS
    while low < high:
        middle = min((low + high) // 2, low + 16)
        low, high = (middle + 1, high) if is_full(middle) else (low, middle)
    good, bad = low, None
    while attempt(good) is None and good < _STEPS:
        good, bad = min(2 * good - low + 1, _STEPS), good
    if bad is None:
        while good > 0 and attempt(good - 1) is not None:
            good -= 1
    else:
        while good - bad > 1 and attempt(good) is not None:
            middle = (good + bad) // 2
            good, bad = (good, middle) if attempt(middle) is None else (middle, bad)
    best = attempt(good)
    if best is None:
        raise GeometryError(
            f"the charts and their padding do not fit into {texture_size} x {texture_size} texels",
            expected=f"room for {n} charts with {padding} texels between them",
            fix="raise texture_size, lower padding, or clean and smooth the mesh so that it has fewer charts",
        )
    scale, turn, corner, rim = best
    x = local[:, 0] * scale + rim
    y = local[:, 1] * scale + rim
    width, height = _cells_of(extent * scale, rim).T
    which = owner[used]
    for k in (1, 2, 3):  # one quarter turn counter-clockwise: (x, y) -> (y, width - x), the sides change roles
        go = turn[which] >= k
        x[go], y[go] = y[go], width[which][go] - x[go]
        width, height = np.where(turn >= k, height, width), np.where(turn >= k, width, height)
    uvs = np.zeros((len(flat), 2))
    uvs[used, 0] = (x + corner[which, 1]) * cell / texture_size
    uvs[used, 1] = 1.0 - (y + corner[which, 0]) * cell / texture_size
    return uvs


def _upright(points: np.ndarray, owner: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(points turned to the smallest upright box of their chart, y downwards, from (0, 0); extents [n, 2])."""
    best_area = np.full(n, np.inf)
    angle = np.zeros(n)
    for turn in np.arange(_ANGLES) * (0.5 * np.pi / _ANGLES):
        _, extent = _boxes(points @ _rotation(turn), owner, n)
        area = extent.prod(axis=1)
        better = area < best_area * (1 - 1e-6)
        best_area[better], angle[better] = area[better], turn
    cos, sin = np.cos(angle)[owner], np.sin(angle)[owner]
    x, y = points.T
    turned = np.stack([cos * x + sin * y, -sin * x + cos * y], axis=1)
    turned[:, 1] *= -1.0
    low, extent = _boxes(turned, owner, n)
    return turned - low[owner], extent


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _boxes(points: np.ndarray, owner: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    np.minimum.at(low, owner, points)
    np.maximum.at(high, owner, points)
    return low, high - low


def _cells_of(extent: np.ndarray, rim: int) -> np.ndarray:
    """Width and height in cells of boxes of this extent with a rim on each side."""
    return np.ceil(extent).astype(np.int64) + 2 * rim


def _place(masks: list[np.ndarray], side: int) -> tuple[np.ndarray, np.ndarray] | None:
    """(quarter turns [n], (row, column) of each chart's box [n, 2]), or None if they do not fit; large ones first."""
    taken = np.zeros((side, side), np.uint8)
    turn, corner = np.zeros(len(masks), np.int64), np.zeros((len(masks), 2), np.int64)
    weight = np.array([mask.sum() for mask in masks])
    order = np.lexsort((-weight, [-max(mask.shape) for mask in masks]))
    for rank, k in enumerate(order):
        choice = _lowest_place(taken, masks[k], 4 if rank < _TURNED else 1)
        if choice is None:
            return None
        turn[k], row, column = choice
        mask = np.rot90(masks[k], turn[k])
        taken[row : row + mask.shape[0], column : column + mask.shape[1]] |= mask
        corner[k] = row, column
    return turn, corner


def _masks(
    local: np.ndarray,
    faces: np.ndarray,
    chart: np.ndarray,
    extent: np.ndarray,
    scale: float,
    side: int,
    margin: float,
) -> list[np.ndarray] | None:
    """The marked cells of every chart, rasterised together on one sheet on which the charts stand in rows.

    None when a chart is larger than the square.
    """
    rim = int(np.ceil(margin - 0.5))
    sizes = _cells_of(extent * scale, rim)
    if sizes.max() > side:
        return None
    width = max(int(sizes[:, 0].max()), int(np.sqrt((sizes + 2).prod(axis=1).sum()) * 1.1) + 1)
    gap = int(np.ceil(margin)) + 1
    row_of, column_of = np.zeros(len(sizes), np.int64), np.zeros(len(sizes), np.int64)
    row = column = tallest = 0
    for k in np.argsort(-sizes[:, 1], kind="stable"):
        w, h = sizes[k] + gap
        if column + w > width + gap:
            row, column, tallest = row + tallest, 0, 0
        row_of[k], column_of[k] = row, column
        column, tallest = column + w, max(tallest, h)
    shape = (int((row_of + sizes[:, 1]).max()), int((column_of + sizes[:, 0]).max()))
    corners = local[faces] * scale + rim
    corners[..., 0] += column_of[chart][:, None]
    corners[..., 1] += row_of[chart][:, None]
    uvs = np.empty((len(local), 2))
    uvs[faces.reshape(-1), 0] = corners[..., 0].reshape(-1) / shape[1]
    uvs[faces.reshape(-1), 1] = 1.0 - corners[..., 1].reshape(-1) / shape[0]
    face_id, _ = rasterize_atlas(uvs, faces, shape, margin=margin)
    shown = np.where(face_id >= 0, chart[face_id], -1)
    masks = []
    for k, (w, h) in enumerate(sizes):
        window = shown[row_of[k] : row_of[k] + h, column_of[k] : column_of[k] + w]
        masks.append(window == k)
    return masks


def _lowest_place(taken: np.ndarray, mask: np.ndarray, turns: int) -> tuple[int, int, int] | None:
    """(quarter turns, row, column) of the free place whose lower end comes first, then leftmost; None without one."""
    from exmesh_graph.raster.warp_runtime import warp

    wp = warp()
    from exmesh_graph.uv.kernels import first_free

    best = None
    for k in range(turns):
        turned = np.rot90(mask, k)
        height, width = turned.shape
        lowest_row = taken.shape[0] - height if best is None else min(taken.shape[0], best[0]) - height
        columns = taken.shape[1] - width + 1
        if lowest_row < 0 or columns <= 0:  # rows that cannot win are not looked at
            continue
        cells = np.argwhere(turned).astype(np.int32)
        cells = cells[np.random.default_rng(0).permutation(len(cells))]  # any order is right, a mixed one fails sooner
        nowhere = np.iinfo(np.int32).max
        found = np.array([nowhere], np.int32)
        with wp.ScopedDevice("cpu"):
            wp.launch(
                first_free,
                dim=(lowest_row + 1) * columns,
                inputs=[
                    wp.array(taken, dtype=wp.uint8, copy=False),
                    wp.array(cells, dtype=wp.vec2i, copy=False),
                    columns,
                    wp.array(found, dtype=int, copy=False),
                ],
            )
        if found[0] != nowhere:
            row, column = divmod(int(found[0]), columns)
            place = (row + height, column, k, row)
            best = place if best is None else min(best, place)
    return None if best is None else (best[2], best[3], best[1])
