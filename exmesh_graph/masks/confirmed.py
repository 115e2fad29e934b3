"""Thin parts of an object that masks lack, and that stereo knows: put back.

A stretcher of a chair before a table of the same wood has no colour of its own, and rods a few pixels wide are lost to
a smooth cut: masks, and the hull of them all, are without. But several views confirm depth and colour of its pixels
(`explained`): something is there. It is the object's where it stands above the table and hangs together with what the
masks do show.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, label

from exmesh_graph.gpu.cores import share
from exmesh_graph.masks.explained import explained
from exmesh_graph.masks.last import Given
from exmesh_graph.masks.outlines import Small
from exmesh_graph.masks.pinhole import pixels_of, rays_of
from exmesh_graph.masks.shape import OUTVOTED
from exmesh_graph.masks.table import Table

_ABOVE, _ROOM = 0.02, 0.1  # of the object's size: above the table, and around the object, what is looked at
_CELL = 1.6  # pixels: of the grid by which things hang together
_SEEN_BY = 2  # views that must show something in a cell
_THEIRS = 0.25  # of the cells of a part, which masks show: else it stands before the object or behind
_OFTEN = 0.15  # of the views: on a pixel of a mask so many points lie, of all views, from which on they show it
_FEW = 0.005  # of the masks' pixels: less is left alone
_KEPT = 0.5  # of what is confirmed beside masks, at least, by those that are cut with it


def confirmed(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks bool [N, h, w], cut around a common shape that has what stereo confirms beside them. None where that is
    little, where the cut does not keep it (a halo, where stereo carries depth across an outline), or where there is no
    table, by which one knows where the object ends."""
    if given.small.table is None:
        return None
    beside = confirmed_beside(given.small, given.small.table, masks, given.near)
    cut = given.cut(masks | beside, OUTVOTED) if beside.sum() > _FEW * masks.sum() else None
    return None if cut is None or (cut & beside).sum() < _KEPT * beside.sum() else cut


def confirmed_beside(small: Small, table: Table, masks: np.ndarray, near: np.ndarray) -> np.ndarray:
    """bool [N, h, w]: pixels beside `masks` bool [N, h, w] on which points lie that views confirm: of the object, whose
    size and place points `near` [P, 3] tell."""
    views, depth = small.views, table.depths.depth
    low, high = near.min(axis=0), near.max(axis=0)
    size = float((high - low).max())
    low, high = low - _ROOM * size, high + _ROOM * size

    def looked_at(view: int) -> np.ndarray:
        rays = rays_of(masks[view].shape, views.intrinsics[view], views.world_to_camera[view])
        far = depth[view] / (rays @ views.world_to_camera[view][2, :3])
        places = views.camera_to_world[view][:3, 3] + far[..., None] * rays
        above = places @ table.plane.normal - table.plane.offset > _ABOVE * size
        return np.where((above & (depth[view] > 0))[..., None], places, np.inf).astype(np.float32)

    places = np.stack(share(looked_at, range(len(masks))))
    inside = ((places > low) & (places < high)).all(axis=-1)
    known = explained(views, depth, small.shown, inside)
    new = known & ~masks
    if not new.any():
        return new
    away = np.linalg.norm(views.camera_to_world[:, :3, 3] - (low + high) / 2, axis=1)
    step = _CELL * float(np.median(away / views.intrinsics[:, 0, 0]))
    cells = _Cells(low, step, tuple(np.ceil((high - low) / step).astype(int) + 1))
    theirs = cells.hanging_together([places[view][known[view]] for view in range(len(masks))],
                                    places[known & masks])  # fmt: skip
    points = places[new]
    points = points[theirs[cells.of(points)]]
    least = max(_SEEN_BY, round(_OFTEN * len(masks)))

    def drawn(view: int) -> np.ndarray:
        place, z = pixels_of(points, views.intrinsics[view], views.world_to_camera[view])
        row, column = np.round(place).astype(int)
        there = (z > 0) & (row >= 0) & (column >= 0) & (row < masks.shape[1]) & (column < masks.shape[2])
        count = np.zeros(masks.shape[1:], np.int32)
        np.add.at(count, (row[there], column[there]), 1)
        return count >= least

    found = np.stack(share(drawn, range(len(masks))))
    return binary_dilation(found, np.ones((1, 3, 3), bool)) & ~masks  # rims are mixed, and not confirmed


class _Cells:
    """A grid of cubes from the corner `low` [3]."""

    def __init__(self, low: np.ndarray, step: float, shape: tuple[int, ...]) -> None:
        self._low, self._step, self._shape = low, step, shape

    def of(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """Indices of the cells of points [P, 3]."""
        return tuple(((points - self._low) / self._step).astype(int).T)

    def hanging_together(self, seen: list[np.ndarray], sure: np.ndarray) -> np.ndarray:
        """bool of the grid's shape: cells in which enough of the views have seen [P, 3] something, and of whose part of
        such cells, corner to corner, enough have a point that is `sure` [P, 3]."""
        count = np.zeros(self._shape, np.int32)
        for points in seen:
            one = np.zeros(self._shape, bool)
            one[self.of(points)] = True
            count += one
        parts, number = label(count >= _SEEN_BY, np.ones((3, 3, 3), bool))
        known = np.zeros(self._shape, bool)
        known[self.of(sure)] = True
        cells, theirs = (np.bincount(parts[which], minlength=number + 1) for which in (count > 0, known))
        held = theirs >= _THEIRS * np.maximum(cells, 1)
        held[0] = False
        return np.asarray(held[parts])
