"""How fine photographs show an object: what voxels and texels are measured by."""

from __future__ import annotations

import numpy as np

FINENESS = 1.25
"""Pixels that a voxel or a texel spans: finer ones hold noise, coarser ones lose what the photographs show."""


def pixel_width(intrinsics: np.ndarray, world_to_camera: np.ndarray, point: np.ndarray) -> float:
    """Width of a pixel at `point` [3], world units: depth / focal length, the median over N views."""
    depth = (world_to_camera @ np.append(point, 1))[:, 2]
    focal = np.sqrt(intrinsics[:, 0, 0] * intrinsics[:, 1, 1])
    return float(np.median(np.maximum(depth, 1e-6) / focal))
