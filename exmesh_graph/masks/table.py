"""How likely pixels show the table that an object stands on, by its picture (`ground`) and by depth.

Where a view's pixel looks at the table, other views that look past the object from elsewhere know its colour. A pixel
of this colour shows the table, one of another colour the object, even where both are of the same wood; and gaps through
which the table is seen are found inside the outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt
from scipy.spatial import ConvexHull, QhullError

from exmesh_graph.gpu.cores import share
from exmesh_graph.masks.cut import together
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.explained import explained
from exmesh_graph.masks.ground import Kind, ground_of
from exmesh_graph.masks.pinhole import rays_of
from exmesh_graph.masks.plane import Plane
from exmesh_graph.types import DepthMaps, Views

_FLAT = 0.01
"""Share by which the depth of a pixel that shows the table may be off the plane's."""
_LOOSE = 2
"""Pixels by which an outline may be off."""
_RIM = 8
"""Pixels inside an outline that are more likely the table's than those deeper in, where the object hides it, explained
or not."""
_BINS = 12
_LEAST_CHANCE, _MOST = 0.02, 0.85
"""Chances that colour alone can give."""
_OWN, _FOREIGN = 0.2, 0.7
"""Chances that a pixel inside the outline shows the table: where the object's depth explains it, and where it does not
but the table's colour does."""


@dataclass(frozen=True)
class Table:
    """The plane that an object stands on, and the views' depth maps that it was found by."""

    plane: Plane
    depths: DepthMaps


def table_shown(
    plane: Plane, views: Views, pictures: np.ndarray, depth: np.ndarray, outlines: np.ndarray, vertices: np.ndarray
) -> np.ndarray | None:
    """float64 [N, h, w] in (0, 1): how likely pixels show the table and not the object; 0.5 where that is not known.

    pictures  float32 [N, h, w, 3], the views' display colour
    depth     [N, h, w], found by stereo; 0 where there is none
    outlines  bool [N, h, w], about what shows the object (vertices [V, 3])
    None where no place of the table is seen by three views.
    """
    flat = _flat(plane, views, depth)
    own = explained(views, depth, pictures, outlines) & ~flat
    outside = np.stack([~binary_dilation(one, iterations=_LOOSE) for one in outlines])
    rim = np.stack(share(lambda one: distance_transform_edt(one) <= _RIM, outlines))
    sure = outside & (flat | ~_around(plane, views, vertices))
    inside = outlines & ~own
    kinds = np.select([sure, outside | (inside & rim), inside], [Kind.BESIDE, Kind.RIM, Kind.DEEP], Kind.NOT)
    ground = ground_of(plane, views, pictures, kinds.astype(np.uint8), vertices)
    if ground is None:
        return None
    alike = np.stack(share(ground.alike, pictures, outlines, views.intrinsics, views.world_to_camera))
    by_colour = chances(alike, outside, own)
    by_depth = np.where(own, _OWN, np.where(by_colour > 0.5, _FOREIGN, 0.5))
    return together(by_colour, np.where(outlines & np.isfinite(alike), by_depth, 0.5))


def _flat(plane: Plane, views: Views, depth: np.ndarray) -> np.ndarray:
    """bool [N, h, w]: pixels that lie on the plane by their depth."""

    def one(view: int) -> np.ndarray:
        to_camera = views.world_to_camera[view]
        far = plane.met(rays_of(depth.shape[1:], views.intrinsics[view], to_camera), to_camera)
        near = np.abs(depth[view] - np.where(np.isfinite(far), far, 0)) <= _FLAT * far
        return (depth[view] > 0) & np.isfinite(far) & near

    return np.stack(share(one, range(len(depth))))


def _around(plane: Plane, views: Views, vertices: np.ndarray) -> np.ndarray:
    """bool [N, h, w]: pixels of the least convex body that reaches from vertices [V, 3] down to the plane; none where
    that has no volume."""
    feet = vertices - plane.height(vertices)[:, None] * plane.normal
    points = np.unique(np.concatenate([vertices, feet]).astype(np.float32), axis=0)
    try:
        body = ConvexHull(points.astype(np.float64), qhull_options="QJ")
    except QhullError:
        return np.zeros((len(views), views.height, views.width), bool)
    return drawn_outlines(points, body.simplices.astype(np.int32), views)


def chances(alike: np.ndarray, table: np.ndarray, own: np.ndarray) -> np.ndarray:
    """float64, as `alike`: the chance that a pixel shows the table, even odds given; 0.5 where `alike` is NaN.

    By how often pixels that show the `table` and pixels of the object's `own` are so alike: where the object has the
    table's colours too, as before a black ground, likeness says little. The more alike the likelier.
    """
    known = np.isfinite(alike)
    if not (table & known).any() or not (own & known).any():
        return np.full(alike.shape, 0.5)
    bins = np.minimum((np.where(known, alike, 0) * _BINS).astype(int), _BINS - 1)
    there, here = (np.bincount(bins[part & known], minlength=_BINS) + 1.0 for part in (table, own))
    odds = np.maximum.accumulate((there / there.sum()) / (here / here.sum()))
    chance = np.clip(odds / (1 + odds), _LEAST_CHANCE, _MOST)
    return np.where(known, chance[bins], 0.5)
