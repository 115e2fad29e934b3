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


def pixels_of(
    points: np.ndarray, camera: np.ndarray, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(depth float [P], row int [P], column int [P]) of points [P, 3] in a picture of `shape` (H, W).

    camera  [3, 4], world to homogeneous pixels
    Outside the picture and behind the camera the depth is NaN, row and column are 0.
    """
    image = points @ camera[:, :3].T + camera[:, 3]
    front = np.maximum(image[:, 2], 1e-6)
    row, column = (np.floor(np.clip(image[:, k] / front, -1, shape[1 - k])).astype(np.int64) for k in (1, 0))
    inside = (image[:, 2] > 1e-6) & (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    return np.where(inside, image[:, 2], np.nan), np.where(inside, row, 0), np.where(inside, column, 0)


def spread_over(count: int, most: int) -> np.ndarray:
    """Indices int64 of at most `most` of `count` views, evenly spread over their order."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(np.int64)) if count else np.arange(0)
