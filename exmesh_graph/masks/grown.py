"""What masks lack beside them: pixels whose colour is the object's and not that of what lies around it.

Stereo has no depth where a surface is smooth, glossy or thin, and an outline moves to edges nearby alone: the rim of a
bowl or a handle stays outside. A pixel may belong to the object where its colour is nearer to the mask's colours than
to those farther out; one view tells that badly, the hull of all views' guesses well (`shape.common_shape`).

Farther out there are two rings. The one just beyond has the background that lies beside the mask. But where half of a
white pot is missing it is of the pot itself, and its colours tell nothing. Then one far beyond is asked as well.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.spatial import cKDTree
from skimage.color import rgb2lab

from exmesh_graph.gpu.cores import share
from exmesh_graph.masks.cut import together

_REACH = 0.18
"""How far beside a mask is looked, in roots of its area; at least `_LEAST_REACH` pixels."""
_LEAST_REACH = 8.0
_RINGS = ((1, 2), (3, 6))
"""Where farther out is, from and to so many reaches."""
_RIM = 2
"""Pixels within a mask's border that may be the background's."""
_LIKELY = 0.6
"""Chance from which on a pixel may be the object's."""
_FOREIGN = 3.0
"""CIELAB units: a colour of the object that lies nearer than this to the surroundings' tells nothing."""
_ELSEWHERE = 5.0
"""CIELAB units by which a colour of the object in other views is taken for farther off."""
_NEAREST = 5
_SAMPLES = 6000
_PART = 32
"""Samples that stand for a part of a ring: the search for more takes its time in proportion."""
_FEWEST = 20


def maybe_shown(
    shown: np.ndarray,
    masks: np.ndarray,
    table: np.ndarray | None = None,
    part: float | None = None,
    *,
    seed: int = 0,
) -> np.ndarray:
    """bool [N, H, W]: `masks` bool [N, H, W] and what beside them may show the object too.

    shown  float32 [N, H, W, 3], the views' display colour in [0, 1]
    table  [N, H, W] in (0, 1): how likely a pixel shows the table, as of `cut.moved_to_edges`
    part   of the ring far beyond, which may be the object's all the same; None: that ring is not asked
    """
    labs = np.stack(share(lab_of, shown))
    own = np.stack([binary_erosion(mask, iterations=_RIM) for mask in masks])
    pool = labs[own]
    pool = pool[np.random.default_rng(seed).permutation(len(pool))[:_SAMPLES]]

    def one(view: int) -> np.ndarray:
        lab, found = labs[view], masks[view].copy()
        beside, near, far_off = _rings(found)
        told = [_colour(lab, own[view], pool, near, beside)]
        if part is not None:
            told.append(_colour(lab, own[view], pool, far_off, beside, part))
        known = [chances for chances in told if chances is not None]
        if known:
            far = np.max(known, axis=0)
            chance = far if table is None else together(far, 1 - table[view][beside])
            found[beside] |= chance > _LIKELY
        return found

    return np.stack(share(one, range(len(masks))))


def lab_of(picture: np.ndarray) -> np.ndarray:
    """float32 [H, W, 3], CIELAB of display colour."""
    return rgb2lab(np.clip(picture, 0, 1)).astype(np.float32)


def _rings(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(pixels beside the mask that may be the object's, the ring around these, one far beyond) bool [H, W]."""
    if not mask.any():
        return mask.copy(), mask.copy(), mask.copy()
    reach = max(_LEAST_REACH, _REACH * float(np.sqrt(mask.sum())))
    away = distance_transform_edt(~mask)
    near, far_off = ((away > low * reach) & (away <= high * reach + _RIM) for low, high in _RINGS)
    return (away > 0) & (away <= reach), near, far_off


def _colour(
    lab: np.ndarray, own: np.ndarray, pool: np.ndarray, around: np.ndarray, beside: np.ndarray, part: float = 0.0
) -> np.ndarray | None:
    """float64 [P], for the pixels `beside`: 1 where the colour is the object's, 0 where it is that of what is `around`.

    Colours that both have are no sign of the object, but for those of a `part` of the ring. None where there is
    nothing to compare with.
    """
    if not (beside.any() and around.any() and own.any()):
        return None
    count = min(int(around.sum()), int(own.sum()))  # alike for both: of more samples one is nearer by chance
    out = cKDTree(_some(lab[around], min(count, round(_PART / part)) if part else count))
    few = max(_NEAREST, round(part * out.n))
    here, elsewhere = (some[_off(out, some, few) > _FOREIGN] for some in (_some(lab[own], count), _some(pool, count)))
    if len(here) < _FEWEST or len(elsewhere) < _FEWEST:
        return None
    colours = lab[beside]
    near = np.minimum(_off(cKDTree(here), colours), _off(cKDTree(elsewhere), colours) + _ELSEWHERE)
    far = _off(out, colours, few)
    return (far + 1e-2) / (near + far + 2e-2)


def colours_nearer(
    lab: np.ndarray, own: np.ndarray, pool: np.ndarray, mask: np.ndarray, asked: np.ndarray, reaches: float
) -> np.ndarray | None:
    """float64 [P], for the pixels `asked` bool [H, W]: 1 where the colour is that of what lies around the `mask`, so
    many reaches far, 0 where it is that of the view's `own` pixels or of the `pool` [Q, 3]. None where there is nothing
    to compare with."""
    reach = max(_LEAST_REACH, _REACH * float(np.sqrt(mask.sum())))
    away = distance_transform_edt(~mask)
    around = (away > _RIM) & (away <= reaches * reach)
    if not asked.any() or min(own.sum(), around.sum()) < _FEWEST:
        return None
    colours = lab[asked]
    out, here, elsewhere = (cKDTree(_some(some, _SAMPLES)) for some in (lab[around], lab[own], pool))
    near = np.minimum(_off(here, colours), _off(elsewhere, colours) + _ELSEWHERE)
    far = _off(out, colours)
    return (near + 1e-2) / (near + far + 2e-2)


def _some(colours: np.ndarray, count: int) -> np.ndarray:
    return colours[:: max(1, -(-len(colours) // min(count, _SAMPLES)))]


def _off(tree: cKDTree, colours: np.ndarray, count: int = _NEAREST) -> np.ndarray:
    """float64 [P]: mean distance to the nearest colours of the tree, from whole CIELAB units, which many share."""
    cells, which = _distinct(np.round(colours).astype(np.int64))
    count = min(count, tree.n)
    return tree.query(cells, k=count)[0].reshape(len(cells), -1).mean(axis=1)[which]


def _distinct(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(the rows of int64 [P, 3] that differ, which of them each row is [P]); values beyond 2**20 are not told apart."""
    keys = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return cells[first], which
