"""What is mended in masks last, once their common shape is known: each step gives other masks, or None, and they are
taken, or parts of them, where outlines then lie better on edges (`agreement`).

Several views may bite the same piece off, where the object looks like what lies behind it. And masks fill what is
narrow or seen from few sides: gaps between rods, the space below a rim or beside a neck. That views look through there
is told by colours (`gaps`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.masks.explained import explained
from exmesh_graph.masks.gaps import reaching_out, seen_through
from exmesh_graph.masks.outlines import Small, small_masks
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.masks.shape import OUTVOTED, common_shape, wrong_views

_BITTEN = 0.12  # of the views, which may lack the same piece
_FEW, _MANY = 0.01, 0.5  # of a mask, and of the views: fewer gaps are left alone
_GAPS_OUTVOTED = 0.12  # of the views: a rod that some take for a gap stays
_NARROW, _UNDERCUT = 7.0, 14.0
"""Half the width, in pixels, of the widest gap, about a window of stereo; and of the widest undercut."""


@dataclass(frozen=True)
class Given:
    """What masks bool [N, h, w] are mended by: their reduced views, which of them show the object (`seen`, bool [N]),
    points around it (`near` [P, 3]), how they are cut, and who is told of progress."""

    small: Small
    seen: np.ndarray
    near: np.ndarray
    cutting: CutSettings
    progress: Callable[[int, int], None] | None = None

    def cut(self, masks: np.ndarray, outvoted: float) -> np.ndarray | None:
        """The common shape of masks cut once more; None where there is none."""
        try:
            seen = self.small.views.subset(np.flatnonzero(self.seen))
            hull = common_shape(seen, masks[self.seen], self.near, self.small.table, outvoted)
        except (DataError, GeometryError):
            return None
        cut = small_masks(self.small, *hull, self.cutting, self.progress)
        cut[~self.seen] = False
        return cut

    def gaps(self, masks: np.ndarray, widest: float) -> np.ndarray:
        """`gaps.seen_through`; none without a table, whose depth maps tell."""
        small = self.small
        if small.table is None:
            return np.zeros_like(masks)
        own = explained(small.views, small.table.depths.depth, small.shown, masks)
        return seen_through(small.shown, masks, own, widest)


def healed(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks cut around a shape from which more views may bite the same piece than before: three of twenty-five.
    None where that is no more of them."""
    count = int(given.seen.sum())
    return None if wrong_views(_BITTEN, count) == wrong_views(OUTVOTED, count) else given.cut(masks, _BITTEN)


def undercut(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks without the gaps that reach in from outside. Few views look there, so that two of them are believed."""
    gaps = reaching_out(given.gaps(masks, _UNDERCUT), masks)
    cut = given.cut(masks & ~gaps, OUTVOTED) if gaps.any() else None
    return None if cut is None else masks & cut


def opened(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks without narrow gaps that several views see. None where few have some."""
    gaps = given.gaps(masks, _NARROW)
    some = (gaps.sum(axis=(1, 2)) > _FEW * masks.sum(axis=(1, 2)))[given.seen]
    cut = None if some.mean() < _MANY else given.cut(masks & ~gaps, _GAPS_OUTVOTED)
    return None if cut is None else masks & cut
