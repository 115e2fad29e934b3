"""A surface drawn into views: which pixels show it."""

from __future__ import annotations

import numpy as np

from exmesh_graph.raster import shown_faces
from exmesh_graph.types import Views


def drawn_outlines(vertices: np.ndarray, faces: np.ndarray, views: Views) -> np.ndarray:
    """bool [N, H, W]: the pixels whose middle shows the mesh (vertices [V, 3], faces [F, 3])."""
    found = np.zeros((len(views), views.height, views.width), bool)
    for view in range(len(views)):
        camera = views.intrinsics[view], views.world_to_camera[view]
        found[view] = shown_faces(vertices, faces, *camera, views.height, views.width) >= 0
    return found
