"""Which face a camera sees at each pixel, from arrays to an array; and whose vertices these are."""

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
    seen = rasterize(*mesh, tensor_of(intrinsics), tensor_of(world_to_camera), height, width, bary=False)
    return torch.as_tensor(seen.face_id).numpy()


def shown_vertices(face_id: torch.Tensor, faces: torch.Tensor, count: int) -> torch.Tensor:
    """bool [V]: of `count` vertices those of the faces (int64 [F, 3]) that a picture shows: face_id [...], -1: none."""
    face, vertex = (torch.zeros(size, dtype=torch.bool, device=faces.device) for size in (len(faces), count))
    face[face_id[face_id >= 0].long()] = True
    vertex[faces[face]] = True
    return vertex
