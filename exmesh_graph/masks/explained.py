"""Which pixels other views explain: they show the same colour at the depth that stereo found there.

Where a gap is narrower than stereo's window, the object's depth is carried across it. The colour there is another
thing's, so that views which look at this depth from elsewhere show other colours.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter

from exmesh_graph.geometry.robust import robust
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.resample import bilinear
from exmesh_graph.masks.pinhole import pixels_of, rays_of
from exmesh_graph.types import Views

_NEAR = 8
_LEAST = 2
_DEPTH = 0.03
"""Share by which another view's own depth may differ where it sees the same point."""
_COLOUR = 0.06
"""Display values: a pixel may be off the other views' median, and these off one another, by so much together."""


def explained(views: Views, depth: np.ndarray, pictures: np.ndarray, outlines: np.ndarray) -> np.ndarray:
    """bool [N, h, w]: the pixels of `outlines` bool [N, h, w] whose colour the views nearby confirm at their depth.

    pictures  float32 [N, h, w, 3], the views' display colour; depth [N, h, w], 0 where there is none. Such pixels take
              the nearest one's
    """
    eyes, cameras = views.camera_to_world[:, :3, 3], views.intrinsics

    def one(view: int) -> np.ndarray:
        outline = outlines[view]
        deep = _filled(depth[view], outline)
        if deep is None:
            return np.zeros_like(outline)
        rays = rays_of(outline.shape, cameras[view], views.world_to_camera[view])[outline]
        far = deep[outline] / (rays @ views.world_to_camera[view][2, :3])
        points = eyes[view] + far[:, None] * rays
        towards = eyes - points.mean(axis=0)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        near = np.argsort(-towards @ towards[view], kind="stable")[1 : _NEAR + 1]
        colours = np.stack(
            [_colours(points, depth[k], pictures[k], cameras[k], views.world_to_camera[k]) for k in near]
        )
        middle, spread, count = robust(colours)
        off = np.abs(pictures[view][outline] - middle).mean(axis=-1)
        alike = np.zeros(outline.shape, np.float32)
        alike[outline] = (count >= _LEAST) & (off + spread < _COLOUR)
        return outline & (uniform_filter(alike, 3, mode="nearest") > 0.5)  # not by chance

    return np.stack(share(one, range(len(outlines))))


def _filled(depth: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """[h, w]: inside the outline pixels without a depth have the nearest one's; None where no pixel has any."""
    known = (depth > 0) & outline
    if not known.any():
        return None
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return depth[tuple(nearest)].astype(np.float64)


def _colours(
    points: np.ndarray, depth: np.ndarray, picture: np.ndarray, k: np.ndarray, to_camera: np.ndarray
) -> np.ndarray:
    """float32 [P, 3]: a view's colours of points [P, 3]; NaN where it does not see them, by its own depth."""
    place, z = pixels_of(points, k, to_camera)
    row, column = np.round(np.clip(place, -1, max(depth.shape))).astype(int)
    there = (row >= 0) & (column >= 0) & (row < depth.shape[0]) & (column < depth.shape[1])
    own = np.where(there, depth[row * there, column * there], 0)
    seen = (own > 0) & (np.abs(own - z) < _DEPTH * z)
    colours = np.full((len(points), 3), np.nan, np.float32)
    colours[seen] = bilinear(picture, place[:, seen])
    return colours
