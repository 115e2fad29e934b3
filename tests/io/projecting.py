"""Pinhole projection, written once more to check what loaders give."""

import numpy as np


def project(points: np.ndarray, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Project [P, 3] world points with one camera: (pixel coordinates [P, 2], camera z [P]).

    Points at or behind the camera plane (z <= 0) get coordinates that mean nothing; test z.
    """
    camera = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    image = camera @ intrinsics.T
    depth = camera[:, 2]
    return image[:, :2] / np.where(np.abs(depth) > 1e-12, depth, 1e-12)[:, None], depth
