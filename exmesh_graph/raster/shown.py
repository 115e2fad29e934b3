"""Which face a camera sees at each pixel, from arrays to an array."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster.rasterize import rasterize


def shown_faces(
    vertices: np.ndarray,
    faces: np.ndarray,
    intrinsics: np.ndarray,
    world_to_camera: np.ndarray,
    height: int,
    width: int,
) -> np.ndarray:
    """int32 [H, W]: the nearest of `faces` [F, 3] at the middle of each pixel, -1 where there is none.

    vertices [V, 3], intrinsics [3, 3] in pixels, world_to_camera [4, 4], OpenCV axes; raises as `rasterize`.
    """
    mesh = tensor_of(np.ascontiguousarray(vertices, np.float32)), tensor_of(np.ascontiguousarray(faces, np.int32))
    seen = rasterize(*mesh, tensor_of(intrinsics), tensor_of(world_to_camera), height, width)
    return torch.as_tensor(seen.face_id).numpy()
