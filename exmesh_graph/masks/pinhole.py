"""Pixels, rays and depths of reduced pictures; a place is (row, column), 0 in the middle of the first pixel."""

from __future__ import annotations

import numpy as np


def thinned(depth: np.ndarray, shape: tuple[int, ...], factor: int) -> np.ndarray:
    """[N, h, w]: every `factor`-th pixel of depth maps [N, H, W], of the middle of each square that became a pixel."""
    rows, columns = (factor // 2 + factor * np.arange(count) for count in shape)
    return depth[:, rows[:, None], columns]


def rays_of(shape: tuple[int, ...], k: np.ndarray, to_camera: np.ndarray) -> np.ndarray:
    """float64 [H, W, 3]: directions in the world of the pixels' middles, one unit of depth long."""
    rows, columns = np.indices(shape[:2]) + 0.5
    return np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(k).T @ to_camera[:3, :3]


def pixels_of(points: np.ndarray, k: np.ndarray, to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(row and column [2, ...], depth [...]) of points [..., 3]; far outside where they are behind the camera."""
    image = points @ to_camera[:3, :3].T + to_camera[:3, 3]
    z = image[..., 2]
    pixel = (image @ k.T)[..., 1::-1] / np.where(z > 1e-6, z, 1e-6)[..., None] - 0.5
    return np.moveaxis(np.where((z > 1e-6)[..., None], pixel, -1e6), -1, 0), z
