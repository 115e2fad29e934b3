"""Sets of evenly spread points: on the unit square, in the unit cube, on the sphere."""

from __future__ import annotations

import math

import numpy as np
import torch


def hammersley(count: int, device: torch.device | str = "cpu") -> torch.Tensor:
    """`count` points (i + 0.5) / n, radical inverse of i in base 2: float32 [count, 2] in [0, 1)."""
    i = torch.arange(count, device=device)
    inverse, base, rest = torch.zeros(count, device=device), 0.5, i.clone()
    while int(rest.max()) > 0:
        inverse += base * (rest % 2)
        rest, base = rest // 2, base / 2
    return torch.stack([(i + 0.5) / count, inverse], dim=1)


def sobol_points(samples: int) -> torch.Tensor:
    """`samples` points [D, 3] of a Sobol sequence in [0, 1)."""
    engine = torch.quasirandom.SobolEngine(3, scramble=True, seed=0)
    return engine.draw(samples)


def fibonacci_sphere(count: int) -> np.ndarray:
    """`count` unit directions of equal area (4 pi / count sr each), float64 [K, 3].

    Heights are the midpoints of equal slices of [-1, 1] (equal areas by Archimedes), longitudes advance by the
    golden angle.
    """
    k = np.arange(count)
    y = 1 - (2 * k + 1) / count
    radius = np.sqrt(1 - y * y)
    longitude = k * (math.pi * (3 - math.sqrt(5)))
    return np.stack([radius * np.sin(longitude), y, radius * np.cos(longitude)], axis=1)


def disc(direction: np.ndarray, count: int, degrees: float) -> np.ndarray:
    """`count` unit directions [N, 3] spread evenly within `degrees` of one."""
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    other = np.cross(direction, across)
    k = np.arange(count)
    reach = math.radians(degrees) * np.sqrt((k + 0.5) / count)
    turn = k * (math.pi * (3 - math.sqrt(5)))
    aside = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * other
    return np.cos(reach)[:, None] * direction + np.sin(reach)[:, None] * aside


def nearest_direction(queries: np.ndarray, directions: np.ndarray, chunk: int = 1 << 16) -> np.ndarray:
    """Index of the direction [K, 3] nearest to each unit query [N, 3]: int64 [N]."""
    index = np.empty(len(queries), np.int64)
    table = directions.astype(np.float32).T.copy()
    for start in range(0, len(queries), chunk):
        part = slice(start, start + chunk)
        index[part] = (queries[part].astype(np.float32) @ table).argmax(axis=1)
    return index
