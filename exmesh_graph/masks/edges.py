"""How much of masks' outlines lies on edges of their pictures: what tells the outline of an object from one across it.

A mask that lacks half of a white pot has a border that runs over white, and one that has leaked over the table has one
that runs over wood. Colours alone do not tell where growing should have ended, the picture beside the border does.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, uniform_filter
from skimage.color import rgb2lab

_WINDOW = 5  # pixels
_CLEAR = 10.0
"""CIELAB units between the colours on both sides of an outline from which on it is a clear edge."""


def on_edges(shown: np.ndarray, masks: np.ndarray) -> float:
    """In [0, 1], the mean over all pixels of outlines: 1 where the colours on both sides are clearly others.

    shown  float32 [N, H, W, 3], the views' display colour in [0, 1];  masks bool [N, H, W]

    Outlines along a picture's border have no other side and do not count; 0 where there is no outline.
    """
    total, count = 0.0, 0
    for picture, mask in zip(shown, masks, strict=True):
        rim = mask & ~binary_erosion(mask, border_value=1)
        if not rim.any():
            continue
        lab = rgb2lab(np.clip(picture, 0, 1))
        apart = np.linalg.norm(_mean(lab, mask)[rim] - _mean(lab, ~mask)[rim], axis=1)
        total += float(np.minimum(apart / _CLEAR, 1.0).sum())
        count += int(rim.sum())
    return total / max(count, 1)


def _mean(lab: np.ndarray, there: np.ndarray) -> np.ndarray:
    """[H, W, 3], mean colour of the pixels `there` bool [H, W] in a window around each."""
    weight = np.maximum(uniform_filter(there.astype(float), _WINDOW), 1e-9)
    return np.stack([uniform_filter(lab[..., c] * there, _WINDOW) / weight for c in range(3)], axis=-1)
