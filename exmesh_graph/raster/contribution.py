"""C_rend of section 4.2: how many pixels of the training views show each face."""

from __future__ import annotations

import numpy as np


def contribution_counts(
    vertices: np.ndarray,
    faces: np.ndarray,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    supersample: int = 1,
) -> np.ndarray:
    """int64 [F], summed over all views, at `supersample` times their resolution.

    intrinsics float [N, 3, 3], camera_to_world float [N, 4, 4]; a face smaller than a pixel may be missed at 1.
    """
    import torch

    from exmesh_graph.gpu.torch_setup import tensor_of
    from exmesh_graph.raster.rasterize import rasterize

    points, triangles = tensor_of(vertices), tensor_of(faces)
    zoom = np.diag([supersample, supersample, 1.0])
    count = np.zeros(len(faces), np.int64)
    for intrinsic, pose in zip(intrinsics, camera_to_world, strict=True):
        fragments = rasterize(
            points,
            triangles,
            torch.from_numpy(zoom @ intrinsic),
            torch.from_numpy(np.linalg.inv(pose)),
            height * supersample,
            width * supersample,
        )
        seen = fragments.face_id.cpu().numpy().reshape(-1)
        count += np.bincount(seen[seen >= 0], minlength=len(faces))
    return count
