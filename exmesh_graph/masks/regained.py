"""What masks show and carving took from a solid: put back, so that nothing thin is lost to its background's depth.

Depth maps of stereo know no rope before a sail: in windows wider than the rope they give it the sail's depth or none,
and a Gaussian takes what one voxel holds. The masks of other views still show it, and every pixel of a mask needs
something along its ray. Of what was taken along it, that stays which most such rays share: a rope lies on the rays of
all views that miss it, what surrounded it in the hull on those of few (the visual hull of what is missing).

Masks that were found err: one that takes the wall behind a chair's rods for the chair misses something that is not
there. Where a few such rays meet is before the solid in all other views, while most of what is thin and real lies
beside it in many.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.ndimage import binary_dilation

from exmesh_graph.geometry.carve import Carving
from exmesh_graph.geometry.hull import projections, reduced_mask, surface
from exmesh_graph.geometry.pixels import pixels_of, spread_over
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.cameras import scale_intrinsics
from exmesh_graph.raster import shown_faces
from exmesh_graph.types import Views

_SIDE = 400  # pixels of a mask's longer side, about: as fine as a hull's voxels
_MOST = 24  # masks that are asked
_ROUNDS = 2
_SHARE = 0.9  # of the missed rays through the point of a ray where most of them meet
_LEAST = 2  # views
_BESIDE = 0.25  # of the views, whose masks, if found, show a point that is put back beside what was carved
_THIN = 0.3  # grid steps below the surface, at least, of a point that is put back


def regained(values: np.ndarray, carving: Carving, views: Views, *, found: bool = False) -> np.ndarray:
    """The field float32 [I, J, K], positive inside, of a solid carved out of `carving.hull`, with what masks miss.

    A mask's rim of a pixel beside what the solid covers is not missed: outlines are found to a fraction of a pixel, and
    Stage I moves them. Views without a mask have no say. Where masks were `found`, not given, a point comes back only
    where a quarter of them show it beside what was carved.
    """
    grid, hull = carving.grid, carving.hull
    told = np.flatnonzero(views.masked)
    told = told[spread_over(len(told), _MOST)]
    masks, intrinsics = _reduced(views, told)
    cameras = projections(intrinsics, views.world_to_camera[told])
    beside: list[np.ndarray] = []
    for _ in range(_ROUNDS):
        covered = _covered(surface(values, grid), masks, intrinsics, views.world_to_camera[told])
        beside = beside or [mask & ~one for mask, one in zip(masks, covered, strict=True)]
        missed = [_missed(mask, one) for mask, one in zip(masks, covered, strict=True)]
        if not any(one.any() for one in missed):
            break
        able = np.flatnonzero((hull > -0.5 * grid.step) & (values <= 0.5 * grid.step))
        able = able[_often(grid.points()[able], cameras, beside)] if found else able
        back = able[_most_missed(grid.points()[able], cameras, missed)]
        values = values.copy()
        values.ravel()[back] = np.maximum(hull.ravel()[back], _THIN * grid.step)
    return values


def _covered(
    mesh: tuple[np.ndarray, np.ndarray], masks: list[np.ndarray], intrinsics: np.ndarray, poses: np.ndarray
) -> list[np.ndarray]:
    """bool [h, w] of each mask: where its view shows the mesh."""

    def one(mask: np.ndarray, k: np.ndarray, pose: np.ndarray) -> np.ndarray:
        return shown_faces(*mesh, k, pose, *mask.shape) >= 0

    return share(one, masks, intrinsics, poses)


def _often(points: np.ndarray, cameras: np.ndarray, beside: list[np.ndarray]) -> np.ndarray:
    """bool [P]: points [P, 3] that enough views show on a pixel that is `beside` bool [H, W] what was carved."""
    count = np.zeros(len(points), np.int32)
    for at, _ in share(partial(_on, points), cameras, beside):
        count[at] += 1
    return count >= max(_LEAST, _BESIDE * len(cameras))


def _most_missed(points: np.ndarray, cameras: np.ndarray, missed: list[np.ndarray]) -> np.ndarray:
    """bool [P]: points [P, 3] on whose rays, among all on a missed pixel's, nearly the most missed rays meet."""
    rays = share(partial(_on, points), cameras, missed)
    count = np.zeros(len(points), np.int32)
    for at, _ in rays:
        count[at] += 1
    chosen = np.zeros(len(points), bool)
    for (at, pixel), one in zip(rays, missed, strict=True):
        most = np.zeros(one.size, np.int32)
        np.maximum.at(most, pixel, count[at])
        chosen[at] |= (count[at] >= _SHARE * most[pixel]) & (most[pixel] >= _LEAST)
    return chosen


def _on(points: np.ndarray, camera: np.ndarray, missed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(which of `points` [P, 3] fall on a pixel that is `missed` bool [H, W], index of that pixel)."""
    z, row, column = pixels_of(points, camera, missed.shape)
    at = np.flatnonzero(np.isfinite(z) & missed[row, column])
    return at, (row * missed.shape[1] + column)[at]


def _missed(mask: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """bool [H, W]: pixels of the mask that are bare, in spots of which some pixel touches nothing covered."""
    bare, around = mask & ~covered, np.ones((3, 3), bool)
    if not bare.any():
        return bare
    return bare & binary_dilation(bare & ~binary_dilation(covered, around), around)


def _reduced(views: Views, told: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """(masks bool [h, w] of the views `told`, their intrinsics), at a whole fraction of their size."""
    factor = max(1, -(-max(views.height, views.width) // _SIDE))
    masks = share(lambda k: reduced_mask(np.asarray(views.alpha[k]), factor) >= 0.5, told)
    return masks, scale_intrinsics(views.intrinsics[told], factor)
