"""Filling the texels around charts, so that no lookup near a border reads what lies between charts."""

from __future__ import annotations

import numpy as np


def dilate(texture: np.ndarray, mask: np.ndarray, radius: float | None = None) -> np.ndarray:
    """Give uncovered texels the value of the nearest covered one.

    texture  float [H, W] or [H, W, C]; mask bool [H, W], covered texels
    radius   in texels; None fills everything
    A texture without covered texels comes back as it was.
    """
    out = texture.copy()
    targets, sources = dilation_sources(mask, radius)
    out[targets] = texture[sources]
    return out


def dilation_sources(mask: np.ndarray, radius: float | None = None) -> tuple[tuple[np.ndarray, ...], ...]:
    """((rows, columns) of the texels that `dilate` fills, (rows, columns) that they take their values from)."""
    from scipy.ndimage import distance_transform_edt

    if not mask.any() or mask.all():
        none = np.zeros(0, np.int64)
        return (none, none), (none, none)
    distance, (rows, columns) = distance_transform_edt(~mask, return_indices=True)
    fill = np.nonzero(~mask if radius is None else ~mask & (distance <= radius))
    return fill, (rows[fill], columns[fill])
