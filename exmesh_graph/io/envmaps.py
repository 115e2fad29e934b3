"""Environment maps: the canonical lat-long layout and the conversion from Blender's.

Canonical (OpenEXR lat-long on the Y-up world): lon = pi (1 - 2u), lat = pi (1/2 - v),
d = (sin lon cos lat, sin lat, cos lon cos lat); the image centre is +Z, u = 1/4 is +X, row 0 is +Y.
Blender (z up): phi = 2 pi (1/2 - u), theta = pi v, d = (sin theta cos phi, sin theta sin phi, cos theta).
With (x, y, z) -> (x, z, -y) Blender's direction has lon = phi + pi/2, so canonical(u) = blender(u + 1/4).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.images import check_finite, read_image


def read_environment(path: Path) -> np.ndarray:
    """Read a lat-long map as float32 [H, W, 3], linear; negative values are set to 0. DataError names the file."""
    pixels = read_image(path)
    if pixels.shape[2] < 3:
        raise DataError("the environment map has no colour", where=str(path), expected="an RGB lat-long EXR")
    check_finite(pixels, Path(path))
    return np.maximum(pixels[..., :3], 0)


def canonical_from_blender(radiance: np.ndarray) -> np.ndarray:
    """Turn a [H, W, C] map from Blender's convention into the canonical one: a shift by -W/4 columns.

    Where W is not a multiple of 4 the map is resampled linearly along each row.
    """
    return shift_columns(radiance, radiance.shape[1] / 4)


def shift_columns(image: np.ndarray, columns: float) -> np.ndarray:
    """out[:, j] = in[:, j + columns], periodic, linear between columns."""
    whole = int(np.floor(columns))
    part = columns - whole
    first = np.roll(image, -whole, axis=1)
    if part == 0:
        return first
    return ((1 - part) * first + part * np.roll(image, -whole - 1, axis=1)).astype(image.dtype)


def canonical_directions(height: int, width: int) -> np.ndarray:
    """float64 [H, W, 3] unit directions of the canonical map's texel centres."""
    lon = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    lat = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    lon, lat = np.meshgrid(lon, lat)
    return np.stack([np.sin(lon) * np.cos(lat), np.sin(lat), np.cos(lon) * np.cos(lat)], axis=-1)
