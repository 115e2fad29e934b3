"""Filling the texels around charts, so that no lookup near a border reads what lies between charts."""

from __future__ import annotations

import numpy as np


def dilate(texture: np.ndarray, mask: np.ndarray, radius: float | None = None) -> np.ndarray:
    """Give uncovered texels the value of the nearest covered one.

    texture  float [H, W] or [H, W, C]; mask bool [H, W], covered texels
    radius   in texels; None fills everything
    A texture without covered texels comes back as it was.
    """
    from scipy.ndimage import distance_transform_edt

    if not mask.any() or mask.all():
        return texture.copy()
    distance, (rows, columns) = distance_transform_edt(~mask, return_indices=True)
    fill = ~mask if radius is None else ~mask & (distance <= radius)
    out = texture.copy()
    out[fill] = texture[rows[fill], columns[fill]]
    return out
