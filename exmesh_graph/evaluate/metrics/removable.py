"""Which parts of what stereo carves out of a hull the photographs let go: a surface may be right here and wrong there.

Two witnesses for each grid point that was taken. The photographs: a pixel that shows the hull there, or what lies
behind it, is foretold from its neighbours over either surface (`opened.Surroundings`), and the point lies on that
pixel's ray between the two. The depth maps, one by one: how many look through the point, and how many have a surface
there, lie before it, or say nothing though they look at it, as before gloss. Gloss lets photographs agree on what lies
behind a surface, but from few sides: without the second witness polished metal is pitted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, label

from exmesh_graph.evaluate.metrics.opened import Surroundings, ratio, shown
from exmesh_graph.geometry.carve import Carving
from exmesh_graph.geometry.hull import projections, surface
from exmesh_graph.geometry.pixels import pixels_of
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.train_size import factor_for, reduced
from exmesh_graph.types import DepthMaps, Views

_SIDE = 128  # pixels: photographs are reduced to about that
_AROUND = 2.0  # grid steps: standard deviation over which witnesses are heard together
_APART = 2.0  # grid steps between the two surfaces along a ray, at least
_HEARD = 0.1  # photographs that a point needs, weighted around it
_THROUGH, _BEFORE = 1.5, 6.0  # grid steps
_SURE = 0.45, 0.3, -1.0  # share of the depth maps that look through a point, less that of those stopped at or before it
_SMALL = 0.1  # of the largest part: smaller ones must show by themselves that they are none of gloss,
_SHARE, _SIGMAS = 0.1, 4.0  # by the error of their details, which falls by this share at least and beyond chance
_LEAST_VIEWS = 3
_PART = 1 << 15  # points that one core looks at in turn


def removable(carving: Carving, views: Views, depths: DepthMaps) -> list[np.ndarray]:
    """What may be taken of `carving.taken`, each bool [I, J, K], from the careful choice to the bold one.

    views, depths  of which `carving` was made
    The bold choice asks the photographs alone. Equal choices are given once.
    """
    taken, grid = carving.taken, carving.grid
    at = np.flatnonzero(taken)
    points = grid.points()[at]
    held = np.zeros(taken.shape, np.float32)

    def around(values: np.ndarray) -> np.ndarray:
        held.ravel()[at] = values
        return gaussian_filter(held, _AROUND).ravel()[at]

    told = _photographs(carving, reduced(views, factor_for(views, _SIDE, 0)))
    heard, gained = (around(part) for part in _heard(points, told, grid.step))
    through, there, silent = (around(part) for part in _sights(points, views, depths, grid.step))
    wanted = (gained > 0) & (heard > _HEARD * around(np.ones(len(at))))
    found: list[np.ndarray] = []
    for sure in _SURE:
        mask = np.zeros(taken.shape, bool)
        mask.ravel()[at] = wanted & (through - there > sure * (through + there + silent))
        mask = _without_gloss(mask, points, at, told, grid.step)
        if not found or (mask != found[-1]).any():
            found.append(mask)
    return found


class _Told(NamedTuple):
    """What a photograph says: its camera [3, 4]; depth float [H, W] of the hull and of what is left; by how much the
    error falls from one to the other, NaN where they are not told apart; the same of details; their error before."""

    camera: np.ndarray
    near: np.ndarray
    far: np.ndarray
    gain: np.ndarray
    detail: np.ndarray
    before: np.ndarray


def _photographs(carving: Carving, views: Views) -> list[_Told]:
    """What each photograph says in which the two surfaces are apart."""
    grid = carving.grid
    both = [Surroundings(views, *surface(values, grid)) for values in (carving.hull, carving.field())]

    def one(view: int, camera: np.ndarray) -> _Told | None:
        near, far = (around.depth[view] for around in both)
        row, column = np.nonzero((near > 0) & (far - near > _APART * grid.step))
        if not len(row):
            return None
        (whole, seen), (left, also) = (_apart(around, view, row, column) for around in both)
        use = row[seen & also], column[seen & also]
        errors = [_errors(part[seen & also], use, near.shape) for part in (whole, left)]
        gain = np.full(near.shape, np.nan)
        gain[use] = (errors[0][0] - errors[1][0])[use]
        return _Told(camera, near, far, gain, errors[0][1] - errors[1][1], errors[0][1])

    told = share(one, range(len(views)), projections(views.intrinsics, views.world_to_camera))
    return [one for one in told if one is not None]


def _apart(around: Surroundings, view: int, row: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(what is foretold of pixels of a view over a surface less what the photograph shows, sRGB [P, 3]; bool [P])."""
    made, seen = around.foretold(view, row, column, around.depth)
    return shown(around.exposure(view)[0] * made) - shown(around.views.images[view][row, column]), seen


def _errors(
    apart: np.ndarray, pixels: tuple[np.ndarray, np.ndarray], shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean absolute difference [H, W] of pixels that differ by `apart` [P, 3], and of their details: 0 elsewhere."""
    known, picture = np.zeros(shape), np.zeros((*shape, 3))
    known[pixels], picture[pixels] = 1, apart
    weight = np.maximum(gaussian_filter(known, _AROUND), 1e-3)
    around = np.stack([gaussian_filter(picture[..., k], _AROUND) / weight for k in range(3)], axis=-1)
    return np.abs(picture).mean(axis=-1), np.abs(picture - around * known[..., None]).mean(axis=-1)


def _heard(points: np.ndarray, told: list[_Told], step: float) -> tuple[np.ndarray, np.ndarray]:
    """(photographs that say something of each of `points` [P, 3], by how much their error falls when it is taken)."""
    heard, gained = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for one in told:
        at, row, column = _between(points, one, step)
        heard[at] += 1
        gained[at] += one.gain[row, column]
    return heard, gained


def _without_gloss(mask: np.ndarray, points: np.ndarray, at: np.ndarray, told: list[_Told], step: float) -> np.ndarray:
    """The mask bool [I, J, K], of grid points [P, 3] with the flat indices `at` [P], less small parts by which details
    are not foretold better."""
    parts, count = label(mask)
    size = np.bincount(parts.ravel(), minlength=count + 1)
    size[0] = 0
    small = (size > 0) & (size < _SMALL * size.max(initial=0))
    part = parts.ravel()[at]
    some = np.flatnonzero(small[part])
    less, before = np.zeros((count + 1, len(told))), np.zeros((count + 1, len(told)))
    for view, one in enumerate(told):
        which, row, column = _between(points[some], one, step)
        pixel = np.unique(part[some[which]].astype(np.int64) * one.near.size + row * one.near.shape[1] + column)
        owner, pixel = np.divmod(pixel, one.near.size)
        less[:, view] = np.bincount(owner, one.detail.ravel()[pixel], minlength=count + 1)
        before[:, view] = np.bincount(owner, one.before.ravel()[pixel], minlength=count + 1)
    keep = ~small
    for number in np.flatnonzero(small):
        views = before[number] > 0
        if views.sum() >= _LEAST_VIEWS:
            share, sigmas = ratio(less[number, views], before[number, views])
            keep[number] = share >= _SHARE and sigmas >= _SIGMAS
    return mask & keep[parts]


def _between(points: np.ndarray, one: _Told, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(which of `points` [P, 3] lie between the surfaces on the ray of a pixel that says something; row; column)."""
    z, row, column = pixels_of(points, one.camera, one.near.shape)
    near, far, gain = (part[row, column] for part in (one.near, one.far, one.gain))
    at = np.flatnonzero((z > near - step) & (z < far + step) & np.isfinite(gain))
    return at, row[at], column[at]


def _sights(points: np.ndarray, views: Views, depths: DepthMaps, step: float) -> tuple[np.ndarray, ...]:
    """How many depth maps look through each of `points` [P, 3], have a surface there or a little before it, and have
    none at its pixel."""
    cameras = projections(views.intrinsics, views.world_to_camera)

    def some(points: np.ndarray) -> np.ndarray:
        counts = np.zeros((3, len(points)), np.float32)
        for camera, depth in zip(cameras, depths.depth, strict=True):
            z, y, x = pixels_of(points, camera, depth.shape)
            seen = depth[y, x]
            beyond = (seen - z) / step
            known = (seen > 0) & np.isfinite(z)
            counts[0] += known & (beyond > _THROUGH)
            counts[1] += known & (beyond <= _THROUGH) & (beyond > -_BEFORE)
            counts[2] += np.isfinite(z) & (seen <= 0)
        return counts

    parts = np.array_split(points, max(1, len(points) // _PART))
    return tuple(np.concatenate(share(some, parts), axis=1))
