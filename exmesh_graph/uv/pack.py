"""Packing of flat charts into a square: bitmaps on a coarse grid, true rotations only, padding exact.

A chart marks every cell whose centre is within padding / 2 + sqrt(1/2) cells of it. Where two charts come closer than
the padding, the cell around the middle of the gap is marked by both; so charts whose marks do not meet keep the
padding. Charts are placed large ones first, each turned so that it ends lowest, at the largest scale that fits; then
other orders are tried at larger scales.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import components
from exmesh_graph.uv.marks import Items, Outlines

_CELLS = 256  # of the grid along a side, at most
_STEP, _STEPS = 0.97, 160
_FULL = 0.8  # part of the square that charts and their padding can usually fill
_ANGLES = 18
_GROW = 1.01  # of the scale, which other orders must gain
_ORDERS = (4, 16, 150)  # tried at one scale: least, most, and that for one chart, shared by all
_MIX = 0.3  # standard deviation of a size's logarithm in such an order


class NoRoomError(GeometryError):
    """Even tiny charts do not fit, with the space between them."""


class _Packed(NamedTuple):
    scale: float
    items: Items
    item: np.ndarray
    corner: np.ndarray


def pack(flat: np.ndarray, corners: np.ndarray, texture_size: int, padding: int) -> np.ndarray:
    """Place charts so that they share no texel and stay `padding` texels apart.

    flat     float [T, 2], coordinates of flat charts in one common unit, orientation positive
    corners  int [F, 3], indices into `flat`; charts are its edge-connected components and share no index
    Returns float64 [T, 2] in [0, 1]. Raises NoRoomError when even tiny charts do not fit.
    """
    chart = components(corners)
    owner = np.full(len(flat), -1, np.int64)
    owner[corners.reshape(-1)] = np.repeat(chart, 3)
    used = np.flatnonzero(owner >= 0)
    points = np.zeros(len(flat), np.complex128)
    points[used] = _upright(flat[used, 0] - 1j * flat[used, 1], owner[used])  # rows go downwards
    outlines = Outlines(points, corners, chart)

    cell = max(1, -(-texture_size // _CELLS))  # texels
    side = texture_size // cell
    margin = 0.5 * padding / cell + 0.5**0.5
    a, b, c = (points[corners[:, k]] for k in range(3))
    largest = side / np.sqrt(0.5 * np.abs(((b - a) * np.conj(c - a)).imag).sum())  # cells per unit

    def attempt(scale: float, orders: int = 1) -> _Packed | None:
        items = outlines.items(scale, side, margin)
        if items is None or items.least > side * side:
            return None
        for order in range(orders):
            placed = _place(items, side, order)
            if placed is not None:
                return _Packed(scale, items, *placed)
        return None

    def is_full(step: int) -> bool:
        items = outlines.items(largest * _STEP**step, side, margin, turned=False)
        return items is None or items.least > _FULL * side * side

    # Marks grow with the scale: find the step at which they fill the usual part of the square, and search from there.
    low, high = 0, _STEPS
    while low < high:
        middle = min((low + high) // 2, low + 16)
        low, high = (middle + 1, high) if is_full(middle) else (low, middle)
    good, bad = low, low - 1
    while (best := attempt(largest * _STEP**good)) is None and good < _STEPS:
        good, bad = min(2 * good - low + 1, _STEPS), good
    if best is None:
        raise NoRoomError(
            f"the charts and their padding do not fit into {texture_size} x {texture_size} texels",
            expected=f"room for {int(chart.max()) + 1} charts with {padding} texels between them",
            fix="raise texture_size, lower padding, or clean and smooth the mesh so that it has fewer charts",
        )
    while good - bad > 1:
        middle = (good + bad) // 2
        packed = attempt(largest * _STEP**middle)
        good, bad, best = (good, middle, best) if packed is None else (middle, bad, packed)
    least, most, shared = _ORDERS
    orders = min(max(shared // (int(chart.max()) + 1), least), most)
    while (packed := attempt(best.scale * _GROW, orders)) is not None:
        best = packed

    item, which = best.item, owner[used]
    shift = best.corner - best.items.low[item] + best.items.rim * (1 + 1j)
    placed = points[used] * (best.items.turn[item] * best.scale)[which] + shift[which]
    uvs = np.zeros((len(flat), 2))
    uvs[used, 0] = placed.real * cell / texture_size
    uvs[used, 1] = 1.0 - placed.imag * cell / texture_size
    return uvs


def _upright(points: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Complex points [T], turned to the smallest upright box of their chart (`owner` [T]), from 0 on."""
    n = int(owner.max()) + 1
    best = np.full(n, np.inf)
    angle = np.ones(n, np.complex128)
    for turn in np.exp(0.5j * np.pi / _ANGLES * np.arange(_ANGLES)):
        low, high = _boxes(points * turn, owner, n)
        area = (high - low).real * (high - low).imag
        better = area < best * (1 - 1e-6)
        best[better], angle[better] = area[better], turn
    turned = points * angle[owner]
    return turned - _boxes(turned, owner, n)[0][owner]


def _boxes(points: np.ndarray, owner: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full((2, n), np.inf), np.full((2, n), -np.inf)
    for axis, value in enumerate((points.real, points.imag)):
        np.minimum.at(low[axis], owner, value)
        np.maximum.at(high[axis], owner, value)
    return low[0] + 1j * low[1], high[0] + 1j * high[1]


def _place(items: Items, side: int, order: int) -> tuple[np.ndarray, np.ndarray] | None:
    """(item of each chart [n], column + i row of its box [n]), or None if they do not fit.

    order  0: longest charts first; others mix longest or largest charts a little
    """
    n = int(items.chart.max()) + 1
    first = np.searchsorted(items.chart, np.arange(n + 1))
    extent = np.maximum.reduceat([0.0 if m is None else float(max(m.shape)) for m in items.masks], first[:-1])
    weight = np.maximum.reduceat([0.0 if m is None else float(m.sum()) for m in items.masks], first[:-1])
    size = np.sqrt(weight) if order % 2 else extent
    if order:
        size = size * np.exp(_MIX * np.random.default_rng(order).normal(size=n))
    taken = np.zeros((side, side), np.uint8)
    item, corner = np.zeros(n, np.int64), np.zeros(n, np.complex128)
    for k in np.lexsort((-weight, -size)).tolist():
        best: tuple[int, int, int, int] | None = None
        for i in range(first[k], first[k + 1]):
            mask = items.masks[i]
            if mask is None:
                continue
            height, width = mask.shape
            rows = (side if best is None else min(side, best[0])) - height + 1  # lower rows cannot win: not looked at
            place = _lowest_place(taken, items.cells(i), rows, side - width + 1)
            if place is not None:
                choice = (place[0] + height, place[1], i, place[0])
                best = choice if best is None else min(best, choice)
        if best is None:
            return None
        _, column, i, row = best
        mask = items.masks[i]
        assert mask is not None
        taken[row : row + mask.shape[0], column : column + mask.shape[1]] |= mask
        item[k], corner[k] = i, column + 1j * row
    return item, corner


def _lowest_place(taken: np.ndarray, cells: np.ndarray, rows: int, columns: int) -> tuple[int, int] | None:
    """The free (row, column) with the lowest row, then column, below (rows, columns); None without one."""
    import torch

    from exmesh_graph.gpu.warp_runtime import launch, warp

    warp()
    from exmesh_graph.uv.kernels import first_free

    if rows <= 0 or columns <= 0:
        return None
    nowhere = np.iinfo(np.int32).max
    lowest = torch.tensor([nowhere], dtype=torch.int32)
    launch(first_free, rows * columns, torch.from_numpy(taken), torch.from_numpy(cells), columns, lowest)
    return None if int(lowest) == nowhere else divmod(int(lowest), columns)
