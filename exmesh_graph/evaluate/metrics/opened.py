"""How much better photographs are foretold where a lid of the surface is open: the judge of `geometry.openings`.

Each of some photographs is foretold from its neighbours over the surface, as `rephotography` does; only the pixels that
show the lid count. Only there depth changes: a ray that meets the lid goes on to where it leaves the opening.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from exmesh_graph.geometry.hull import Grid, surface
from exmesh_graph.geometry.lids import Lid, lids
from exmesh_graph.geometry.openings import Lidded, Opening, best_opening
from exmesh_graph.geometry.pixels import spread_over
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.color import linear_to_srgb, srgb_to_linear
from exmesh_graph.io.resample import bilinear
from exmesh_graph.io.train_size import factor_for, reduced
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.types import Views

_SPREAD, _NEAREST = 10.0, 8  # degrees; photographs: as `rephotography`
_FOOTPRINTS = 3.0  # pixels' widths within which two depths are of one surface
_SIDE = 128  # pixels: photographs are reduced to about that
_MOST, _ASKED = 16, 10_000  # photographs foretold, and pixels of all of them
_SHOWN = 30  # pixels of the lid that a photograph shows, at least
_LEAST_VIEWS = 4
_SHARE, _SIGMAS, _BETTER = 0.1, 6.0, 0.8  # of `Gain`, at least
_SIGMAS_OF_ALL = 5.0  # where every photograph is foretold better
_DETAIL = 3.0  # pixels: standard deviation of what a pixel is compared with for `detailed`


@dataclass(frozen=True)
class Gain:
    """By how much the error of the lid's pixels falls, as a share of it; the same in standard errors (of a ratio of
    sums over photographs); the share of the photographs that are foretold better; that of the pixels which no other
    photograph shows; by what share the error of their detail falls, where that had a say in the lengths."""

    share: float
    sigmas: float
    better: float
    unseen: float
    detail: float = 0.0

    @property
    def enough(self) -> bool:
        """Whether it is beyond chance and beyond what gloss on a flat part brings."""
        sigmas = _SIGMAS_OF_ALL if self.better == 1 else _SIGMAS
        return self.share >= _SHARE and self.sigmas >= sigmas and self.better >= _BETTER


def openings(values: np.ndarray, grid: Grid, views: Views) -> list[tuple[Opening, Gain]]:
    """What the photographs find open in a solid, the field [I, J, K] positive inside, through each of its lids.

    They say whether a lid is open, and how deep behind which wall; where their detail is foretold better as well, it
    says that with them. For what metal mirrors lies elsewhere than its surface, and only a pattern on it lies there.
    """
    vertices, faces = surface(values, grid)
    around: Surroundings | None = None
    found = []
    for lid in lids(values, grid, vertices, faces):
        around = around or Surroundings(reduced(views, factor_for(views, _SIDE, 0)), vertices, faces)
        judge, lidded = Judge(around, lid), Lidded(values, grid, vertices, faces, lid)
        opening = best_opening(lidded, judge) if judge.able else None
        if opening is None or not (gain := judge.gain(opening)).enough:
            continue
        detail = Judge(around.seeing(detailed(around.views)), lid)
        both = best_opening(lidded, _mean_of(judge, detail))
        if both is not None and detail(both) >= _SHARE and judge(both) > 0:
            opening, gain = both, replace(gain, detail=detail(both))
        found.append((opening, gain))
    return found


def _mean_of(*judges: Judge) -> Callable[[Opening], float]:
    return lambda opening: float(np.mean([judge(opening) for judge in judges]))


def detailed(views: Views) -> Views:
    """Photographs less the mean about each pixel of the object, in display values about one half."""

    def one(picture: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        held = (alpha > 0.5).astype(np.float64)
        values, weight = shown(picture.astype(np.float64)), gaussian_filter(held, _DETAIL)
        about = gaussian_filter(values * held[..., None], (_DETAIL, _DETAIL, 0)) / np.maximum(weight, 1e-3)[..., None]
        return srgb_to_linear(np.clip(0.5 + values - about, 0, 1)).astype(np.float32)

    return replace(views, images=np.stack(share(one, views.images, views.alpha)))


class Surroundings:
    """The photographs, and how a closed surface (vertices [V, 3], faces [F, 3]) lies before them."""

    def __init__(self, views: Views, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.views, self.poses, self.inverse = views, views.camera_to_world, views.world_to_camera
        mesh = (
            torch.from_numpy(np.ascontiguousarray(vertices, np.float32)),
            torch.from_numpy(np.ascontiguousarray(faces, np.int32)),
        )
        drawn = share(lambda view: _drawn(mesh, views, view), range(len(views)))
        self.depth, self.face = (np.stack([one[part] for one in drawn]) for part in (0, 1))
        axes = self.poses[:, :3, 2]
        self.near = np.argsort(-(axes @ axes.T), axis=1, kind="stable")[:, 1 : _NEAREST + 1]

    def seeing(self, views: Views) -> Surroundings:
        """The same surface before other pictures of the same cameras."""
        other = copy(self)
        other.views = views
        return other

    def exposure(self, view: int) -> np.ndarray:
        """float64 [3]: what a view's photograph is, channel by channel, times what its neighbours foretell of it."""
        row, column = np.nonzero(self.depth[view] > 0)
        thin = slice(None, None, 1 + len(row) // 4000)
        made, seen = self.foretold(view, row[thin], column[thin], self.depth)
        truth = self.views.images[view][row[thin], column[thin]][seen].astype(np.float64)
        made = made[seen]
        return (made * truth).sum(0) / np.maximum(np.square(made).sum(0), 1e-12)

    def foretold(
        self, view: int, row: np.ndarray, column: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(linear colour float64 [P, 3], seen bool [P]) of pixels of a view, over the depth maps [N, H, W]."""
        views = self.views
        eyes, rays = _rays(views, self.poses, np.full(len(row), view), row, column)
        z = depth[view, row, column]
        points = eyes + rays * z[:, None]
        here = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        total, weights = np.zeros((len(row), 3)), np.zeros(len(row))
        for other in self.near[view]:
            pose, k = self.inverse[other], views.intrinsics[other]
            local = points @ pose[:3, :3].T + pose[:3, 3]
            front = np.maximum(local[:, 2], 1e-6)
            x, y = ((local / front[:, None]) @ k.T)[:, :2].T
            inside = (x >= 0.5) & (x < views.width - 0.5) & (y >= 0.5) & (y < views.height - 0.5) & (z > 0)
            at = np.where(inside, y, 0).astype(int), np.where(inside, x, 0).astype(int)
            met = depth[other][at]
            close = np.abs(met - front) < _FOOTPRINTS * front / np.sqrt(k[0, 0] * k[1, 1])
            use = np.flatnonzero(inside & (local[:, 2] > 0) & (met > 0) & close)
            if not len(use):
                continue
            there = points[use] - self.poses[other][:3, 3]
            there /= np.linalg.norm(there, axis=1, keepdims=True)
            angle = np.degrees(np.arccos(np.clip((here[use] * there).sum(1), -1, 1)))
            weight = np.exp(-np.square(angle / _SPREAD)) + 1e-6
            colour = bilinear(views.images[other], np.stack([y[use], x[use]]) - 0.5)
            total[use] += weight[:, None] * colour
            weights[use] += weight
        return total / np.maximum(weights, 1e-12)[:, None], weights > 0


class Judge:
    """What photographs say of openings through one lid."""

    def __init__(self, around: Surroundings, lid: Lid) -> None:
        self.around = around
        of_lid = np.isin(around.face, lid.faces)
        self.view, self.row, self.column = (index.astype(np.int64) for index in np.nonzero(of_lid))
        views = around.views
        self.eyes, self.rays = _rays(views, around.poses, self.view, self.row, self.column)
        self.start = around.depth[self.view, self.row, self.column]
        able = np.flatnonzero(of_lid.reshape(len(of_lid), -1).sum(axis=1) >= _SHOWN)
        held = able[spread_over(len(able), _MOST)]
        asked = np.flatnonzero(np.isin(self.view, held))
        asked = asked[:: 1 + len(asked) // _ASKED]
        self.asked = [asked[self.view[asked] == view] for view in held]
        self.gains = [around.exposure(int(view)) for view in held]
        self.closed = self._errors(around.depth)

    @property
    def able(self) -> bool:
        """Whether enough photographs show the lid."""
        return len(self.asked) >= _LEAST_VIEWS

    def __call__(self, opening: Opening) -> float:
        return self.gain(opening).share

    def gain(self, opening: Opening) -> Gain:
        """Of this opening over the closed lid. A pixel that no other photograph shows counts as it was."""
        depth = self.around.depth.copy()
        depth[self.view, self.row, self.column] = opening.exits(self.eyes, self.rays, self.start)
        less, before, unseen = (np.zeros(len(self.asked)) for _ in range(3))
        for k, (closed, error) in enumerate(zip(self.closed, self._errors(depth), strict=True)):
            known = np.isfinite(error) & np.isfinite(closed)
            gained, was = np.where(known, closed - error, 0.0), np.nan_to_num(closed)
            less[k], before[k], unseen[k] = gained.sum(), was.sum(), 1 - known.mean()
        share, sigmas = ratio(less, before)
        return Gain(share, sigmas, float((less > 0).mean()), float(unseen.mean()))

    def _errors(self, depth: np.ndarray) -> list[np.ndarray]:
        """Of the pixels asked in each view: mean absolute difference, sRGB; NaN where no other view shows them."""
        found = []
        for mine, gain in zip(self.asked, self.gains, strict=True):
            view, row, column = int(self.view[mine[0]]), self.row[mine], self.column[mine]
            made, seen = self.around.foretold(view, row, column, depth)
            error = np.abs(shown(gain * made) - shown(self.around.views.images[view][row, column])).mean(axis=1)
            found.append(np.where(seen, error, np.nan))
        return found


def ratio(less: np.ndarray, before: np.ndarray) -> tuple[float, float]:
    """(sum of one over sum of the other, the same in its standard errors), of N pairs."""
    whole = max(float(before.sum()), 1e-9)
    share = float(less.sum()) / whole
    spread = np.sqrt(len(less) / (len(less) - 1) * np.square(less - share * before).sum()) / whole
    return share, float(share / max(spread, 1e-9))


def _drawn(mesh: tuple[torch.Tensor, torch.Tensor], views: Views, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth float32 [H, W], 0 beside the mesh, and the face that a pixel shows, -1 there."""
    intrinsics, pose = torch.from_numpy(views.intrinsics[view]), torch.from_numpy(views.world_to_camera[view])
    seen = rasterize_projected(project(mesh[0], intrinsics, pose), mesh[1], views.height, views.width, bary=False)
    return seen.depth.numpy(), seen.face_id.numpy()


def _rays(
    views: Views, poses: np.ndarray, view: np.ndarray, row: np.ndarray, column: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eyes and rays float64 [P, 3], world; a ray goes one unit along its camera's axis."""
    k, pose = views.intrinsics[view], poses[view]
    x = (column + 0.5 - k[:, 0, 2]) / k[:, 0, 0]
    y = (row + 0.5 - k[:, 1, 2]) / k[:, 1, 1]
    rays = np.einsum("pij,pj->pi", pose[:, :3, :3], np.stack([x, y, np.ones_like(x)], axis=-1))
    return pose[:, :3, 3], rays


def shown(linear: np.ndarray) -> np.ndarray:
    """sRGB of linear colour, cut to what a picture holds."""
    return linear_to_srgb(np.clip(linear, 0, 1))
