"""Which surface casts light in a score: what the held-out pictures allow to be there.

A relightable asset is shaded by its own surface. A sheet that no pixel judges could so darken an asset that is too
bright, or brighten a dark one, and a figure would get better by surface that is wrong. So surface casts light (stops
it, sends it back, is mirrored) only where fewer than half of the held-out views refute it:

- with masks, a view refutes a point that it would show beside the mask;
- with a `Region`, a point that it would show beside the region, or in front of the depths at which the region has its
  surface. What lies behind these depths is hidden, which is no refutation.

Points that no held-out picture holds are refuted as well. All surface is still seen, and judged where pixels count;
and a table whose depth the photographs confirm is in the region and shades the object. Each point is judged for itself:
surface that is added or deleted elsewhere changes nothing about it.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from exmesh_graph.io.shots import spread
from exmesh_graph.types import Mesh, Region, Views

_VOTERS = 32  # views that are asked, evenly spread
_RIM = 0.02  # of a picture's longer side: nearer to the mask or region a point is not refuted
_SPACING = 0.05  # normalised units between the points of a face that are asked
_FINEST = 64  # parts of a face's edge, at most


def casting_faces(surface: Mesh, views: Views, region: Region | None = None) -> np.ndarray | None:
    """bool [F], the faces of `surface` that cast light when it is scored on `views`; None where all do.

    `region` is that of views without masks (evaluate.coverage.region_rows says whether it fits). A face casts light if
    its corners and all points of a grid of `_SPACING` on it may.
    """
    chosen = spread(len(views), _VOTERS)
    if views.has_masks or region is None:
        parts = [_Judge(views, i, views.alpha[i] > 0, None) for i in chosen]
    else:
        row_of = {name: row for row, name in enumerate(region.names)}
        rows = [row_of[views.names[i]] for i in chosen]
        parts = [
            _Judge(views, i, region.inside[row], region.near[row])
            for i, row in zip(chosen, rows, strict=True)
            if region.inside[row].any()
        ]
    vertices, faces = np.asarray(surface.vertices, np.float64), np.asarray(surface.faces)
    casts = _allowed(vertices, parts)[faces].all(axis=1)
    pieces = _pieces(vertices, faces)
    for count in np.unique(pieces[casts]):
        asked = np.flatnonzero(casts & (pieces == count))
        weights = _grid(int(count))
        points = np.einsum("gc,fcx->fgx", weights, vertices[faces[asked]])
        casts[asked] = _allowed(points.reshape(-1, 3), parts).reshape(len(asked), -1).all(axis=1)
    return None if casts.all() else casts


def casting_share(surface: Mesh, casts: np.ndarray | None) -> float:
    """Share of the surface's area that casts light."""
    if casts is None:
        return 1.0
    a, b, c = np.asarray(surface.vertices, np.float64)[np.asarray(surface.faces)].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(area[casts].sum() / max(area.sum(), 1e-30))


class _Judge:
    """One view: which points its picture holds, and which of them it refutes."""

    def __init__(self, views: Views, row: int, inside: np.ndarray, near: np.ndarray | None) -> None:
        reach = 2 * int(np.ceil(_RIM * max(inside.shape))) + 1
        self.wide = maximum_filter(inside, size=reach)
        self.near = None if near is None else np.where(inside, near, 0)
        self.pose, self.intrinsics = views.world_to_camera[row], views.intrinsics[row]

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(in the picture, refuted), both bool [N], of `points` [N, 3]."""
        seen = points @ self.pose[:3, :3].T + self.pose[:3, 3]
        depth = seen[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = np.floor((seen @ self.intrinsics[:2].T) / depth[:, None]).T
        height, width = self.wide.shape
        held = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place = np.where(held, row, 0).astype(np.int64), np.where(held, column, 0).astype(np.int64)
        refuted = ~self.wide[place]
        if self.near is not None:
            refuted |= depth < self.near[place]
        return held, held & refuted


def _allowed(points: np.ndarray, judges: list[_Judge]) -> np.ndarray:
    """bool [N]: held by a picture, and refuted by fewer than half of those that hold it."""
    held, refuted = np.zeros(len(points), np.int32), np.zeros(len(points), np.int32)
    for judge in judges:
        here, not_here = judge(points)
        held += here
        refuted += not_here
    return 2 * refuted < held


def _pieces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Into how many parts each face's edges are cut, int [F]: 1 where the corners suffice."""
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    return np.clip(np.ceil(longest / _SPACING), 1, _FINEST).astype(np.int64)


def _grid(count: int) -> np.ndarray:
    """Barycentric weights [G, 3] of the points that cut each edge into `count` parts; the centre for 1."""
    if count == 1:
        return np.full((1, 3), 1 / 3)
    i, j = np.mgrid[: count + 1, : count + 1].reshape(2, -1)
    kept = i + j <= count
    return np.stack([i, j, count - i - j], axis=1)[kept] / count
