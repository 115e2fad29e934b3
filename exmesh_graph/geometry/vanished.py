"""Parts that have shrunk to nothing: what photographs refute, an optimiser moves into a point."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import components

_NOTHING = 0.05
"""Side of a part's bounding box over the mesh's median edge: faces are a pixel or more, so nobody sees such a part."""


def vanished(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """bool [F]: faces of the connected parts whose bounding box is smaller than a twentieth of the mesh's median edge.

    vertices  float [V, 3]; faces int [F, 3]

    Such a part (a leaf of the coarse start that no photograph shows, shrunk to a point) is invisible, but its faces
    have no area, on the surface or in any atlas, and no edge collapse may remove the last faces of a closed part.
    """
    points = vertices[faces].astype(np.float64)
    if len(faces) == 0:
        return np.zeros(0, bool)
    part = components(faces)
    count = int(part.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, points.min(axis=1))
    np.maximum.at(high, part, points.max(axis=1))
    edge = np.median(np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2))
    return ((high - low).max(axis=1) < _NOTHING * edge)[part]
