"""The common shape of masks: their visual hull, in which some of them are outvoted."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.grounded import Grounded
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.masks.table import Table
from exmesh_graph.types import Views

#: The share of the views that may be wrong anywhere.
OUTVOTED = 0.05
_ROOM = 0.2


def common_shape(
    views: Views, masks: np.ndarray, near: np.ndarray, table: Table | None = None, outvoted: float = OUTVOTED
) -> tuple[np.ndarray, np.ndarray]:
    """The visual hull (vertices, faces) of bool [N, H, W], around points `near` [P, 3] and above the `table`; the share
    `outvoted` of the views may be.

    Raises DataError where the masks have no common part there.
    """
    cameras, wrong = (views.intrinsics, views.world_to_camera), wrong_views(outvoted, len(views))
    field = SilhouetteField.from_masks(masks, *cameras, wrong_masks=wrong, names=views.names)
    if table is not None:
        field = Grounded.above(field, table.plane.normal, table.plane.offset)
    low, high = near.min(axis=0).astype(float), near.max(axis=0).astype(float)
    room = _ROOM * (high - low).max()
    return visual_hull(field, resolution=0, low=low - room, high=high + room)


def wrong_views(share: float, views: int) -> int:
    """How many masks may be, of so many views."""
    return min(max(1, round(share * views)), views - 1)
