"""Cameras that look at an asset."""

from __future__ import annotations

import math

import numpy as np

FIELD = math.radians(35)
"""Full vertical angle of view."""

MARGIN = 1.05


def orbit(
    count: int, height: int, width: int, *, elevation: float = 0.35, start: float = 0.0, radius: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics [N, 3, 3] and camera_to_world [N, 4, 4] of `count` cameras on a circle around +Y.

    Conventions as types.Views. All see the whole ball of `radius` around the origin from `elevation` [rad] above the
    horizon, |elevation| < pi/2; the first one stands at azimuth `start` [rad] from +Z towards +X.
    """
    focal = 0.5 * height / math.tan(0.5 * FIELD)
    narrow = min(FIELD, 2 * math.atan(0.5 * width / focal))
    distance = MARGIN * radius / math.sin(0.5 * narrow)
    azimuth = start + 2 * np.pi * np.arange(count) / count
    flat = math.cos(elevation)
    backward = np.stack([flat * np.sin(azimuth), np.full(count, math.sin(elevation)), flat * np.cos(azimuth)], axis=-1)
    right = np.stack([np.cos(azimuth), np.zeros(count), -np.sin(azimuth)], axis=-1)
    down = np.cross(-backward, right)
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, 0], pose[:, :3, 1], pose[:, :3, 2] = right, down, -backward
    pose[:, :3, 3] = distance * backward
    intrinsics = np.array([[focal, 0, 0.5 * width], [0, focal, 0.5 * height], [0, 0, 1]])
    return np.tile(intrinsics, (count, 1, 1)), pose
