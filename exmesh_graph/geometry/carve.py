"""Depth maps and masks to a closed mesh: the visual hull, less what depth maps have looked through.

A truncated signed distance on a regular grid (Curless and Levoy 1996), kept below the hull's own field. What no depth
map says anything of stays solid, so that nothing has to be filled: the result is closed, where fusing alone leaves
holes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

from exmesh_graph.geometry.hull import (
    GRAIN,
    Grid,
    SilhouetteField,
    field_kernels,
    occupied_box,
    projections,
    shown_resolution,
)
from exmesh_graph.geometry.pixels import pixels_of
from exmesh_graph.geometry.settings import TsdfSettings
from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.types import DepthMaps, Views


@dataclass(frozen=True)
class Carving:
    """A visual hull and what depth maps leave of it, on one grid.

    hull, left  float32 [I, J, K], world units, positive inside; `left` is not smoothed
    limit       where the depth maps' field is cut off, world units;  blur: grid steps
    """

    grid: Grid
    hull: np.ndarray
    left: np.ndarray
    limit: float
    blur: float

    def field(self, kept: np.ndarray | None = None) -> np.ndarray:
        """float32 [I, J, K]: what is left, smoothed where depth maps carve; where `kept` bool [I, J, K], the hull."""
        left = self.left if kept is None else np.where(kept, self.hull, self.left)
        return blurred(left, left != self.hull, self.blur, self.limit)

    @cached_property
    def taken(self) -> np.ndarray:
        """bool [I, J, K]: grid points of the hull that lie outside what is left."""
        return (self.hull > 0) & (self.field() < 0)


def carving(
    field: SilhouetteField,
    views: Views,
    depths: DepthMaps,
    settings: TsdfSettings | None = None,
) -> Carving:
    """What masks and depth maps leave of a solid.

    field  the masks' implicit function; every view of it needs a mask
    The resolution is along the longest side of the hull's box. A depth map speaks of what lies up to the truncation
    behind its surface; what is before it counts so. Where fewer than `min_weight` views speak the hull alone decides.
    Where depth maps carve, from `clear` voxels below the hull on (`carved`), a Gaussian of `blur` voxels smooths it.

    Raises DataError where views and depth maps do not belong together or the masks have nothing in common.
    """
    settings = settings or TsdfSettings()
    depths.require_of(views, "init.tsdf")
    low, high = occupied_box(field, np.full(3, -field.reach), np.full(3, field.reach))
    grid = Grid.over(low, high, settings.resolution or shown_resolution(field, low, high))
    points = grid.points()
    hull = field(points, floor=-3 * grid.step)
    inside = np.flatnonzero(hull > -2 * grid.step)
    limit = settings.truncation * grid.step
    said = depth_field(points[inside], views, depths, limit, settings.min_weight)
    left = hull.copy()
    left[inside] = carved(hull[inside], said, settings.clear * grid.step)
    return Carving(grid, hull.reshape(grid.shape), left.reshape(grid.shape), limit, settings.blur)


def carved(hull: np.ndarray, said: np.ndarray, clear: float) -> np.ndarray:
    """The hull's field where depth maps put the surface less than `clear` below it, theirs where more than twice that.

    The smaller of two noisy fields lies inside both: a fit that agrees with the outline would take its noise off the
    rim. Between the two lengths a straight line joins them.
    """
    below = hull - said
    return hull - np.clip(2 * (below - clear), 0, np.maximum(below, 0))


def blurred(values: np.ndarray, changed: np.ndarray, sigma: float, limit: float) -> np.ndarray:
    """The field [I, J, K], cut at `limit`, under a Gaussian of `sigma` grid steps where it was `changed`, and around.

    Depth maps of stereo disagree by a voxel from cell to cell, which marching cubes would turn into hundreds of
    handles. What the hull alone decides keeps its edges.
    """
    if sigma == 0:
        return values
    share = np.clip(2 * gaussian_filter(changed.astype(np.float32), sigma, mode="nearest"), 0, 1)
    cut = np.clip(values, -limit, limit)
    return cut + share * (gaussian_filter(cut, sigma, mode="nearest") - cut)


def depth_field(points: np.ndarray, views: Views, depths: DepthMaps, limit: float, least: float) -> np.ndarray:
    """Mean signed distance float32 [P] along z at points [P, 3], world units, positive behind the surface, cut at
    -limit; +limit where fewer than `least` views speak."""
    points, values = np.ascontiguousarray(points, np.float32), np.empty(len(points), np.float32)
    given = (points, depths.depth, projections(views.intrinsics, views.world_to_camera), values)
    split(field_kernels().depth_field, len(points), float(least), float(limit), *map(tensor_of, given), grain=GRAIN)
    return values


def plain_depth_field(points: np.ndarray, views: Views, depths: DepthMaps, limit: float, least: float) -> np.ndarray:
    """`depth_field` in numpy."""
    total, weight = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for matrix, depth in zip(projections(views.intrinsics, views.world_to_camera), depths.depth, strict=True):
        z, row, column = pixels_of(points, matrix, depth.shape)
        seen = depth[row, column]
        behind = z - seen
        speaks = (seen > 0) & (behind < limit)  # not where z is NaN
        total += np.where(speaks, np.maximum(behind, -limit), 0)
        weight += speaks
    return np.where(weight >= least, total / np.maximum(weight, 1), limit)
