"""A surface drawn into views: which pixels show it."""

from __future__ import annotations

import numpy as np

from exmesh_graph.gpu.cores import share
from exmesh_graph.raster import shown_faces
from exmesh_graph.types import Views


def drawn_outlines(vertices: np.ndarray, faces: np.ndarray, views: Views) -> np.ndarray:
    """bool [N, H, W]: the pixels whose middle shows the mesh (vertices [V, 3], faces [F, 3])."""

    def one(k: np.ndarray, to_camera: np.ndarray) -> np.ndarray:
        return shown_faces(vertices, faces, k, to_camera, views.height, views.width) >= 0

    return np.stack(share(one, views.intrinsics, views.world_to_camera))
