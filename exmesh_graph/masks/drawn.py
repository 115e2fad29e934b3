"""A surface drawn into views: which pixels show it."""

from __future__ import annotations

import numpy as np

from exmesh_graph.raster import shown_faces
from exmesh_graph.types import Views


def drawn_outlines(vertices: np.ndarray, faces: np.ndarray, views: Views, factor: int = 1) -> np.ndarray:
    """bool [N, H // factor, W // factor]: the pixels whose middle shows the mesh (vertices [V, 3], faces [F, 3])."""
    height, width = views.height // factor, views.width // factor
    found = np.zeros((len(views), height, width), bool)
    for view in range(len(views)):
        k = np.array(views.intrinsics[view], np.float64)
        k[:2] /= factor
        found[view] = shown_faces(vertices, faces, k, views.world_to_camera[view], height, width) >= 0
    return found
