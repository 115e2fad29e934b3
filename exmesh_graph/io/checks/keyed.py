"""Whether masks that a flat ground gave are those of one object: their visual hull covers them."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.io.load import Loaded
from exmesh_graph.io.normalise import sphere_from_masks
from exmesh_graph.raster import shown_faces

LEAST_COVERED = 0.88
"""Of a mask, median over the views. Rods, leaves and wires come to 0.90 and more, mirrors before white to 0.83."""
_ROOM = 1.05


def covered_by_hull(loaded: Loaded) -> float:
    """Share of a mask that the visual hull of all of them covers, drawn back: the median over the views, 0 without one.

    Where the object has the ground's colour its mask lacks a piece, whose rays are cut out of the hull; other views
    show what is missing there.
    """
    masks, k = loaded.silhouettes, loaded.silhouette_intrinsics
    to_camera = np.linalg.inv(loaded.camera_to_world)
    try:
        centre, radius = sphere_from_masks(masks, k, loaded.camera_to_world, names=loaded.names)
        low, high = ((centre + sign * _ROOM * radius).tolist() for sign in (-1, 1))
        hull = visual_hull(SilhouetteField.from_masks(masks, k, to_camera), resolution=0, low=low, high=high)
    except (DataError, GeometryError):
        return 0.0
    shares = []
    for mask, camera, pose in zip(masks, k, to_camera, strict=True):
        inside = mask >= 0.5
        drawn = shown_faces(*hull, camera, pose, *mask.shape) >= 0
        shares.append((drawn & inside).sum() / inside.sum())
    return float(np.median(shares))
