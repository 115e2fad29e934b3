"""What an object stands on, where cameras look down at it: the hull of its masks ends there, not in a point below.

From above no outline shows how far an object goes down. The hull goes on below it in a cone, as steep as the lowest
camera looks: under a board that is seen from 13 degrees up, by a fifth of its width. Things stand on something flat.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter

from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.gpu.cores import share

#: Voxels along the longest side of the hull that is looked at; of these a cell of a picture holds about two.
VOXELS = 128
_CELL = 2.0
_LEAST = 0.02
"""Of the object's longest side: a cone that goes less far below is left."""

_WIDEST = 4.0
"""Tangent of the angle off a camera's axis within which points count: some lie beside it or behind."""


class Footing(NamedTuple):
    """A level plane, y = `height`; `depth`: how far the hull goes on below it."""

    height: float
    depth: float


def base_row(base: Footing) -> dict[str, Any]:
    """The row of the decisions."""
    reason = (
        f"Cameras look down at it: no outline shows what lies below y = {base.height:.3f}, where the hull went on by "
        f"{base.depth:.3f}. It ends there, as things do that stand."
    )
    return {"name": "base", "value": "flat", "reason": reason}


def footing(field: SilhouetteField) -> Footing | None:
    """The level plane that the hull may end at with all outlines as they are: None where it hardly goes on below.

    Along each ray through an outline something of the hull lies highest; the lowest of all these heights is the plane's
    (less a cell, so fine is this told). The world's y axis is up.
    """
    points = np.asarray(visual_hull(field, resolution=VOXELS)[0], np.float64)
    low, high = points.min(0), points.max(0)
    size = float((high - low).max())
    cell = _CELL * size / VOXELS
    lowest = min(share(lambda k, pose: _tops(points, k, pose, cell).min(), field.intrinsics, field.world_to_camera))
    level = float(lowest) - cell
    return Footing(level, level - float(low[1])) if level - low[1] >= _LEAST * size else None


def _tops(points: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray, cell: float) -> np.ndarray:
    """The highest y of the points [P, 3] in and around each cell of a picture that holds any; a cell is `cell` wide at
    the middle of the points."""
    seen = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    before = np.abs(seen[:, :2]).max(1) < _WIDEST * seen[:, 2]
    seen, height = seen[before], points[before, 1]
    if not len(seen):
        return np.full(1, np.inf)
    width = cell * intrinsics[0, 0] / np.median(seen[:, 2])
    place = np.floor((seen[:, :2] / seen[:, 2:] * intrinsics[[0, 1], [0, 1]]) / width).astype(np.int64)
    place -= place.min(0)
    tops = np.full(place.max(0) + 1, -np.inf)
    np.maximum.at(tops, (place[:, 0], place[:, 1]), height)
    # a cell that shows what is above may hold none of its points: then its neighbours do
    return maximum_filter(tops, 3)[np.isfinite(tops)]
