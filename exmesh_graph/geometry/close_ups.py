"""Close-ups: pictures that show a part of the object, beside others that show it whole."""

from __future__ import annotations

import numpy as np

_WHOLE = 3
"""Views that show the object whole, from which on close-ups are taken as such."""
_CUT = 0.75
"""Of the root of a silhouette's area: how long a part of the picture's edge it takes up in a close-up. Close-ups of
parts have 1 to 3, pictures that cut a rim 0.6 at most."""


def close_ups(cut: np.ndarray) -> np.ndarray:
    """Of views, bool [N], that cut the object off those that say nothing of what lies beyond their edges: all, where
    enough others show it whole, else none."""
    return cut & ((~cut).sum() >= _WHOLE)


def cuts_off(mask: np.ndarray) -> bool:
    """Whether the edges of the picture cut much of the object off, by its mask, bool [H, W].

    Where they take a corner of it, it hardly goes on but where it touches them.
    """
    edge = sum(int(part.sum()) for part in (mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]))
    return edge > _CUT * float(np.sqrt(mask.sum()))
