"""Gaps that masks fill: narrow, and each view shows something else in them, which it shows beside the object too.

Stereo's windows carry the depth of rods across the gaps between them. A mask that was cut from that surface then has
the background's colours for its own, and the cut leaves them inside.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, label, maximum, uniform_filter

from exmesh_graph.gpu.cores import share
from exmesh_graph.masks.grown import colours_nearer, lab_of

_RIM = 1.5
"""Pixels of a mask's border that a gap is not looked for in: the cut has moved it."""
_OUT = 3
"""Pixels between a mask's border and a gap that reaches it: the rim, and one."""
_LIKELY = 0.6
_AROUND = 3.0
"""How far around a mask its surroundings are asked, in reaches of `grown`."""


def seen_through(shown: np.ndarray, masks: np.ndarray, own: np.ndarray, widest: float) -> np.ndarray:
    """bool [N, h, w]: the pixels of `masks` bool [N, h, w] that show what lies behind the object, in a narrow gap.

    shown   float32 [N, h, w, 3], the views' display colour in [0, 1]
    own     bool [N, h, w], pixels that other views confirm at the depth that stereo has there (`explained`)
    widest  half the width of a gap, in pixels, at most

    Such a pixel is none of `own`, and its colour is nearer to those around the mask than to the view's own, or all
    views' own.
    """
    labs = np.stack(share(lab_of, shown))
    pool = labs[own]

    def one(view: int) -> np.ndarray:
        mask = masks[view]
        gap = mask & ~own[view] & (distance_transform_edt(mask) > _RIM)
        chance = np.zeros(mask.shape)
        chances = colours_nearer(labs[view], own[view], pool, mask, gap, _AROUND)
        if chances is None:
            return np.zeros_like(mask)
        chance[gap] = chances
        return _narrow(gap & (uniform_filter(chance, 3, mode="nearest") > _LIKELY), widest)

    return np.stack(share(one, range(len(masks))))


def reaching_out(gaps: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """bool [N, h, w]: the parts of `gaps` that reach the border of `masks`, but for its rim."""
    out = np.zeros_like(gaps)
    for view, gap in enumerate(gaps):
        parts, _ = label(gap)
        reached = np.unique(parts[binary_dilation(~masks[view], iterations=_OUT)])
        out[view] = gap & np.isin(parts, reached)
    return out


def _narrow(found: np.ndarray, widest: float) -> np.ndarray:
    """bool [h, w] without parts that are wider than a gap."""
    parts, count = label(found)
    if count == 0:
        return found
    deep = maximum(distance_transform_edt(found), parts, np.arange(count + 1))
    return found & (np.asarray(deep) <= widest)[parts]
