"""How fine photographs show an object: what voxels, texels and faces are measured by."""

from __future__ import annotations

import numpy as np

FINENESS = 1.25
"""Pixels that a voxel or a texel spans: finer ones hold noise, coarser ones lose what the photographs show."""


def pixel_width(intrinsics: np.ndarray, world_to_camera: np.ndarray, point: np.ndarray) -> float:
    """Width of a pixel at `point` [3], world units: depth / focal length, the median over N views."""
    depth = (world_to_camera @ np.append(point, 1))[:, 2]
    focal = np.sqrt(intrinsics[:, 0, 0] * intrinsics[:, 1, 1])
    return float(np.median(np.maximum(depth, 1e-6) / focal))


def faces_at(vertices: np.ndarray, faces: np.ndarray, edge: float) -> int:
    """How many equilateral faces of edge length `edge` have the area of the mesh (vertices [V, 3], faces [F, 3])."""
    corners = vertices[faces].astype(np.float64)
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return int(doubled.sum() / 2 / (np.sqrt(3) / 4 * edge**2))
