"""Whether masks that a flat ground gave are those of one object: their visual hull covers them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.hull import SilhouetteField, hull_field, projections
from exmesh_graph.io.load import Loaded
from exmesh_graph.io.normalise import sphere_from_masks

LEAST_COVERED = 0.98
"""Of a mask, median over the views. Rods, leaves and wires come to 0.999, mirrors before white to 0.93 to 0.977."""
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
        values, grid = hull_field(SilhouetteField.from_masks(masks, k, to_camera), resolution=0, low=low, high=high)
    except (DataError, GeometryError):
        return 0.0
    inside = grid.points()[values.ravel() > -0.5 * grid.step]
    shares = []
    for mask, camera in zip(masks >= 0.5, projections(k, to_camera), strict=True):
        image = inside @ camera[:, :3].T + camera[:, 3]
        column, row = np.floor(image[:, :2] / image[:, 2:]).astype(int).T
        there = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        drawn = np.zeros_like(mask)
        drawn[row[there], column[there]] = True
        shares.append((binary_dilation(drawn, np.ones((3, 3))) & mask).sum() / mask.sum())  # a voxel is a pixel wide
    return float(np.median(shares))
