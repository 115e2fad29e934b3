"""From a lens to a pinhole: which pinhole, and where its pixels lie in the photograph."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from exmesh_graph.io.images import Photo

_SCALES = (0.5, 2.0)

Project = Callable[[np.ndarray], np.ndarray]
"""Rays [P, 3] of camera axes to pixels [P, 2] of the photograph."""


def pinhole(project: Project, intrinsics: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """(K [3, 3], float32 [H, W, 2] pixels of the photograph) of the widest pinhole all of whose pixels it holds.

    `intrinsics` are the lens's without distortion: principal point and picture size stay, the focal lengths are
    multiplied by one factor between 1/2 and 2.
    """
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    edge = np.ones((height, width), bool)
    edge[1:-1, 1:-1] = False
    border = np.stack([x[edge], y[edge]], axis=1)

    def places(pixels: np.ndarray, scale: float) -> np.ndarray:
        focal = scale * np.array([intrinsics[0, 0], intrinsics[1, 1]])
        rays = (pixels - intrinsics[:2, 2]) / focal
        return project(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))

    def held(scale: float) -> bool:
        at = places(border, scale)
        return bool(((at >= 0) & (at <= [width, height])).all())

    low, high = _SCALES
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if held(middle) else (middle, high)
    k = np.array(intrinsics, np.float64)
    k[[0, 1], [0, 1]] *= high
    where = places(np.stack([x.ravel(), y.ravel()], axis=1), high)
    return k, where.reshape(height, width, 2).astype(np.float32)


def resampled(photo: Photo, places: np.ndarray) -> Photo:
    """The photograph at `places` [H, W, 2], by cubic splines in linear, premultiplied light."""
    from scipy.ndimage import map_coordinates

    at = [places[..., 1] - 0.5, places[..., 0] - 0.5]

    def sample(channel: np.ndarray) -> np.ndarray:
        return map_coordinates(channel, at, order=3, mode="nearest", output=np.float32)

    alpha = np.clip(sample(photo.alpha), 0, 1) if photo.has_alpha else photo.alpha
    rgb = np.stack([sample(photo.rgb[..., c]) for c in range(3)], axis=-1)
    top = alpha[..., None] if photo.clipped else np.inf
    return Photo(np.clip(rgb, 0, top).astype(np.float32), alpha, photo.has_alpha, photo.clipped)
