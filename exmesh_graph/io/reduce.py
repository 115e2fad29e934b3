"""Pictures made smaller, by a whole factor or any: the exact mean over the area of each new pixel, in linear light."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import reduced_size
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import linear_of_codes

_STRIP = 1 << 22  # values in float64 at once


def downscale_area(image: np.ndarray, factor: int, where: Path | str = "") -> np.ndarray:
    """Exact mean over factor x factor blocks of [H, W] or [H, W, C]; DataError unless factor divides H and W."""
    if factor == 1:
        return image
    height, width = image.shape[:2]
    if height % factor or width % factor:
        fits = [f for f in range(2, 17) if height % f == 0 and width % f == 0]
        raise DataError(
            f"{width} x {height} pixels cannot be reduced by {factor}", where=str(where),
            expected="a factor that divides width and height", fix=f"downscale: one of {fits or [1]}",
        )  # fmt: skip
    blocks = image.reshape(height // factor, factor, width // factor, factor, *image.shape[2:])
    # numpy's mean over two axes walks through memory in short steps; sums in float64 are exact in any order
    rows = blocks[:, 0].astype(np.float64)
    for k in range(1, factor):
        rows += blocks[:, k]
    total = rows[:, :, 0]
    for k in range(1, factor):
        total = total + rows[:, :, k]
    return (total / factor**2).astype(np.float32)


def area_means(values: np.ndarray, factor: float) -> np.ndarray:
    """float32 [h, w] or [h, w, C]: means of [H, W(, C)] over squares of `factor` >= 1 pixels, not necessarily whole.

    What does not fill a square is left off at both sides alike, so the middle stays the middle.
    """
    width, height = reduced_size((values.shape[1], values.shape[0]), factor)
    rows = _edges(values.shape[0], height, factor)
    strip = max(1, int(_STRIP / (factor * values[0].size)))
    parts = []
    for first in range(0, height, strip):
        edges = rows[first : first + strip + 1]
        low, high = int(edges[0]), min(values.shape[0], int(np.ceil(edges[-1])))
        part = _means(values[low:high].astype(np.float64), edges - low, axis=0)
        parts.append(_means(part, _edges(values.shape[1], width, factor), axis=1).astype(np.float32))
    return np.concatenate(parts)


def reduced_codes(codes: np.ndarray, factor: float) -> np.ndarray:
    """uint16 [h, w, C] of uint8 or uint16 [H, W, C], C 1, 3 or 4, sRGB with straight alpha.

    Means are of linear, premultiplied light. 16 bits, so that what 8 bits would round away a second time stays.
    """
    has_alpha = codes.shape[2] in (2, 4)
    linear = np.take(linear_of_codes(codes.dtype), codes[..., :-1] if has_alpha else codes)
    if not has_alpha:
        return _codes(linear_to_srgb(area_means(linear, factor)))
    alpha = codes[..., -1:].astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
    means = area_means(np.concatenate([linear * alpha, alpha], axis=2), factor)
    straight = means[..., :-1] / np.maximum(means[..., -1:], 1e-6)
    return _codes(np.concatenate([linear_to_srgb(np.clip(straight, 0, 1)), means[..., -1:]], axis=2))


def _edges(length: int, count: int, factor: float) -> np.ndarray:
    return np.clip((length - count * factor) / 2 + factor * np.arange(count + 1), 0, length)


def _means(values: np.ndarray, edges: np.ndarray, axis: int) -> np.ndarray:
    """Means between neighbouring `edges`: differences of the integral, which is linear inside a pixel."""
    values = np.moveaxis(values, axis, 0)
    integral = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    whole = np.minimum(edges.astype(int), len(values) - 1)
    part = (edges - whole).reshape(-1, *[1] * (values.ndim - 1))
    at = integral[whole] + part * values[whole]
    width = np.diff(edges).reshape(part[1:].shape)
    return np.moveaxis(np.diff(at, axis=0) / width, 0, axis)


def _codes(values: np.ndarray) -> np.ndarray:
    return np.round(np.clip(values, 0, 1).astype(np.float64) * 65535).astype(np.uint16)
