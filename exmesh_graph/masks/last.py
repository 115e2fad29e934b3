"""What is mended in masks last, once their common shape is known: each step gives other masks, or None, and they are
taken where outlines then lie better on edges (`agreement`).

Several views may bite the same piece off, where the object looks like what lies behind it. And masks fill what is
narrow or seen from few sides: gaps between rods, the space below a rim or beside a neck. That views look through there
is told by colours (`gaps`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import DataError, GeometryError
from exmesh_graph.geometry.hull import reduced_mask
from exmesh_graph.masks.explained import explained
from exmesh_graph.masks.gaps import reaching_out, seen_through
from exmesh_graph.masks.ground import Table
from exmesh_graph.masks.outlines import looked_at, masks_of_surface
from exmesh_graph.masks.pinhole import thinned
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.masks.shape import OUTVOTED, common_shape, wrong_views
from exmesh_graph.types import Views

_BITTEN = 0.12  # of the views, which may lack the same piece
_FEW, _MANY = 0.01, 0.5  # of a mask, and of the views: fewer gaps are left alone
_GAPS_OUTVOTED = 0.12  # of the views: a rod that some take for a gap stays
_NARROW, _UNDERCUT = 7.0, 14.0
"""Half the width, in pixels, of the widest gap, about a window of stereo; and of the widest undercut."""


@dataclass(frozen=True)
class Given:
    """What masks bool [N, H, W] are mended by: their views, which of them show the object (`seen`, bool [N]), points
    around it (`near` [P, 3]), how they are cut, the table, and who is told of progress."""

    views: Views
    seen: np.ndarray
    near: np.ndarray
    cutting: CutSettings
    table: Table | None
    progress: Callable[[int, int], None] | None

    def cut(self, masks: np.ndarray, outvoted: float) -> np.ndarray | None:
        """The common shape of masks [N, h, w], perhaps of reduced views, cut once more; None where there is none."""
        small = self.views if masks.shape[1:] == (self.views.height, self.views.width) else self.looked_at()[0]
        try:
            seen = small.subset(np.flatnonzero(self.seen))
            hull = common_shape(seen, masks[self.seen], self.near, self.table, outvoted)
        except (DataError, GeometryError):
            return None
        cut = masks_of_surface(self.views, *hull, self.cutting, table=self.table, progress=self.progress)
        cut[~self.seen] = False
        return cut

    def looked_at(self) -> tuple[Views, np.ndarray, int]:
        """`outlines.looked_at`."""
        return looked_at(self.views, self.cutting)


def healed(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks cut around a shape from which more views may bite the same piece than before: three of twenty-five.
    None where that is no more of them."""
    count = int(given.seen.sum())
    return None if wrong_views(_BITTEN, count) == wrong_views(OUTVOTED, count) else given.cut(masks, _BITTEN)


def undercut(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks without the gaps that reach in from outside. Few views look there, so that two of them are believed."""
    if given.table is None:
        return None
    gaps, reduced = _gaps(given, given.table, masks, _UNDERCUT)
    cut = given.cut(reduced & ~reaching_out(gaps, reduced), OUTVOTED)
    return None if cut is None else masks & cut


def opened(given: Given, masks: np.ndarray) -> np.ndarray | None:
    """The masks without narrow gaps that several views see. None where few have some."""
    if given.table is None:
        return None
    gaps, reduced = _gaps(given, given.table, masks, _NARROW)
    some = (gaps.sum(axis=(1, 2)) > _FEW * reduced.sum(axis=(1, 2)))[given.seen]
    cut = None if some.mean() < _MANY else given.cut(reduced & ~gaps, _GAPS_OUTVOTED)
    return None if cut is None else masks & cut


def _gaps(given: Given, table: Table, masks: np.ndarray, widest: float) -> tuple[np.ndarray, np.ndarray]:
    """(gaps, masks) bool [N, h, w] of the reduced views."""
    small, shown, factor = given.looked_at()
    reduced = np.stack([reduced_mask(mask, factor) >= 0.5 for mask in masks])
    depth = thinned(table.depths.depth, (small.height, small.width), factor)
    return seen_through(shown, reduced, explained(small, depth, shown, reduced), widest), reduced
