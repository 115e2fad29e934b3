"""How much of masks' outlines lies on edges of their pictures: what tells the outline of an object from one across it.

A mask that lacks half of a white pot has a border that runs over white, and one that has leaked over the table has one
that runs over wood. Colours alone do not tell where growing should have ended, the picture beside the border does.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, find_objects, label, uniform_filter
from skimage.color import rgb2lab

from exmesh_graph.gpu.cores import share

_WINDOW = 5  # pixels
_AROUND = 2  # pixels around what changes, in which outlines are compared
_LEAST = 4  # pixels of a part that is worth it
_CLEAR = 10.0
"""CIELAB units between the colours on both sides of an outline from which on it is a clear edge."""


def on_edges(shown: np.ndarray, masks: np.ndarray) -> float:
    """In [0, 1], the mean over all pixels of outlines: 1 where the colours on both sides are clearly others.

    shown  float32 [N, H, W, 3], the views' display colour in [0, 1];  masks bool [N, H, W]

    Outlines along a picture's border have no other side and do not count; 0 where there is no outline.
    """
    total, count = 0.0, 0
    for picture, mask in zip(shown, masks, strict=True):
        clear = _clear(_lab(picture), mask)
        total, count = total + float(clear.sum()), count + len(clear)
    return total / max(count, 1)


def better_parts(shown: np.ndarray, masks: np.ndarray, changed: np.ndarray) -> np.ndarray:
    """`masks` bool [N, H, W] with those parts of what `changed` [N, H, W] adds or takes whose outlines then lie better
    on edges of the pictures: what mends a bite in one view may fill a handle in another."""

    def one(view: int) -> np.ndarray:
        mask, lab, room = masks[view].copy(), _lab(shown[view]), _WINDOW + _AROUND
        parts, _ = label(mask ^ changed[view], np.ones((3, 3), bool))
        for number, place in enumerate(find_objects(parts), 1):
            window = tuple(slice(max(0, side.start - room), side.stop + room) for side in place)
            part, before = parts[window] == number, mask[window]
            near = binary_dilation(part, iterations=_AROUND)
            old, new = (_clear(lab[window], inside, near) for inside in (before, before ^ part))
            if part.sum() >= _LEAST and len(old) and len(new) and new.mean() > old.mean():
                mask[window] = before ^ part
        return mask

    return np.stack(share(one, range(len(masks))))


def _lab(picture: np.ndarray) -> np.ndarray:
    return np.asarray(rgb2lab(np.clip(picture, 0, 1)))


def _clear(lab: np.ndarray, mask: np.ndarray, where: np.ndarray | None = None) -> np.ndarray:
    """[P] in [0, 1], how other the colours lab [H, W, 3] on both sides are, of each pixel of a mask's rim (`where`)."""
    rim = mask & ~binary_erosion(mask, border_value=1)
    rim = rim if where is None else rim & where
    if not rim.any():
        return np.zeros(0)
    apart = np.linalg.norm(_mean(lab, mask)[rim] - _mean(lab, ~mask)[rim], axis=1)
    return np.minimum(apart / _CLEAR, 1.0)


def _mean(lab: np.ndarray, there: np.ndarray) -> np.ndarray:
    """[H, W, 3], mean colour of the pixels `there` bool [H, W] in a window around each."""
    weight = np.maximum(uniform_filter(there.astype(float), _WINDOW), 1e-9)
    return np.stack([uniform_filter(lab[..., c] * there, _WINDOW) / weight for c in range(3)], axis=-1)
