"""Sets of directions on the sphere."""

from __future__ import annotations

import math

import numpy as np


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


def nearest_direction(queries: np.ndarray, directions: np.ndarray, chunk: int = 1 << 16) -> np.ndarray:
    """Index of the direction [K, 3] nearest to each unit query [N, 3]: int64 [N]."""
    index = np.empty(len(queries), np.int64)
    table = directions.astype(np.float32).T.copy()
    for start in range(0, len(queries), chunk):
        part = slice(start, start + chunk)
        index[part] = (queries[part].astype(np.float32) @ table).argmax(axis=1)
    return index
