"""Cameras on spirals around the origin, and the rays of their pixels (the Blender / NeRF convention)."""

from __future__ import annotations

import math

import numpy as np

DISTANCE, FIELD = 3.7, 2 * math.asin(1.2 / 3.7) * 1.02


def spiral(count: int, low: float, high: float, phase: float, seed: int) -> list[np.ndarray]:
    """Camera-to-world [4, 4] (x right, y up, looking along -z): heights z / |eye| from low to high by the golden angle,
    distances 3.7 +- 3 %."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        height = low + (k + 0.5) / count * (high - low)
        found.append(_looking(height, k * math.pi * (3 - math.sqrt(5)) + phase, DISTANCE * rng.uniform(0.97, 1.03)))
    return found


def rings(count: int, low: float, high: float, rows: int = 2) -> list[np.ndarray]:
    """As `spiral`, of a camera on a tripod before a turntable: so many even turns, each from one height."""
    found = []
    for row, turn in enumerate(np.array_split(np.arange(count), rows)):
        height = low + (row + 0.5) / rows * (high - low)
        found += [_looking(height, 2 * math.pi * (k + row / rows) / len(turn), DISTANCE) for k in range(len(turn))]
    return found


def _looking(height: float, angle: float, distance: float) -> np.ndarray:
    level = math.sqrt(1 - height**2)
    back = np.array([level * math.cos(angle), level * math.sin(angle), height])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(back, right), back, distance * back])
    return pose


def rays(pose: np.ndarray, size: int, fine: int = 1) -> np.ndarray:
    """Origins and unit directions float32 [size * fine, size * fine, 6] through the middles of fine x fine parts of
    every pixel."""
    focal = 0.5 * size / math.tan(0.5 * FIELD)
    at = (np.arange(size * fine) + 0.5) / fine
    x, y = np.meshgrid((at - size / 2) / focal, -(at - size / 2) / focal)
    towards = np.stack([x, y, np.full_like(x, -1)], axis=-1) @ pose[:3, :3].T
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    return np.concatenate([np.broadcast_to(pose[:3, 3], towards.shape), towards], axis=-1).astype(np.float32)
