"""The object among what depth maps show: fused, without what views look through, without its table, closed.

Depth maps that were found without masks hold the object, the ground it stands on, pieces of the surroundings and lumps
in the air. What is left of them is drawn into each view; the visual hull of these outlines is closed and rough.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.ndimage import binary_closing, label, uniform_filter

from exmesh_graph.geometry.clean import largest_components
from exmesh_graph.geometry.grounded import Grounded
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.geometry.settings import TsdfSettings
from exmesh_graph.geometry.tsdf import fuse
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.train_size import reduced
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.pinhole import thinned
from exmesh_graph.masks.plane import Plane
from exmesh_graph.masks.settings import ObjectSettings
from exmesh_graph.masks.standing import Standing, standing
from exmesh_graph.masks.wide import brought_back, widened
from exmesh_graph.types import DepthMaps, Views

_SHOWN = 0.8
_HOLES = 0.002
_CLOSED = 2
_WINDOW = 3


def object_of_depths(
    views: Views, depths: DepthMaps, settings: ObjectSettings | None = None, *, side: int = 400, seed: int = 0
) -> Standing:
    """The object that stands amidst `views`, closed, by their depth maps in the sphere of radius `settings.reach`.

    Pictures and maps are looked at reduced to a longer side of at most `side` pixels, which the sizes of windows and
    cracks here are meant for. Raises DataError where views and maps do not belong together or nothing left of the
    surface is common to the views, GeometryError where the depth maps give no surface, where nothing is left of it, and
    for table: remove where no table was found.
    """
    settings = settings or ObjectSettings()
    reach, voxel = settings.reach, 2.0 / settings.resolution
    depths.require_of(views, "init.object")
    small, maps = _looked_at(views, depths, side)
    wide, maps = widened(small, reach), brought_back(maps, 1 / reach)
    maps = structured(wide, maps, settings.least_structure)
    fused = TsdfSettings(resolution=settings.resolution, masked=False, truncation=6, min_weight=2, radius=1)
    vertices, faces = fuse(wide, maps, fused)
    alone = standing(vertices, faces, wide, maps, voxel, settings.table, settings.least_part, shown=_SHOWN, seed=seed)
    ground = alone.table if alone.removed else None
    vertices, faces = _closed(alone.vertices, alone.faces, wide, ground, settings.least_part)
    table = alone.table and replace(alone.table, offset=alone.table.offset * reach)
    return replace(alone, vertices=vertices * np.float32(reach), faces=faces, table=table)


def open_object(
    views: Views,
    depths: DepthMaps,
    vertices: np.ndarray,
    faces: np.ndarray,
    voxel: float,
    table: Literal["auto", "remove", "keep"] = "auto",
    *,
    side: int = 400,
    seed: int = 0,
) -> Standing:
    """What of a surface, fused from `depths` of `views` in voxels of `voxel`, is no lump in the air and no table.

    What goes on beyond the pictures stays. Raises GeometryError as `object_of_depths`.
    """
    small, maps = _looked_at(views, depths, side)
    return standing(vertices, faces, small, maps, voxel, table, seed=seed)


def _looked_at(views: Views, depths: DepthMaps, side: int) -> tuple[Views, DepthMaps]:
    factor = max(1, math.ceil(max(views.width, views.height) / side))
    small = reduced(views, factor)
    return small, replace(depths, depth=thinned(depths.depth, (small.height, small.width), factor))


def structured(views: Views, depths: DepthMaps, least: float) -> DepthMaps:
    """The depth maps without the pixels around which the picture is flat (deviation of 3 x 3 below `least`).

    Windows of stereo carry the object's depth onto a flat background beside it.
    """

    def one(picture: np.ndarray, depth: np.ndarray) -> np.ndarray:
        grey = linear_to_srgb(np.clip(np.asarray(picture), 0, 1)).mean(axis=-1, dtype=np.float64)
        mean, square = (uniform_filter(part, _WINDOW, mode="nearest") for part in (grey, grey**2))
        return np.where(square - mean**2 < least**2, np.float32(0), depth)

    return replace(depths, depth=np.stack(share(one, views.images, depths.depth)))


def _closed(
    vertices: np.ndarray, faces: np.ndarray, views: Views, table: Plane | None, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """The hull of the open surface's outlines, above the table, without small parts."""
    outlines = np.stack([_filled(one) for one in drawn_outlines(vertices, faces, views)])
    seen = outlines.any(axis=(1, 2))
    field = SilhouetteField.from_masks(outlines[seen], views.intrinsics[seen], views.world_to_camera[seen])
    if table is not None:
        field = Grounded.above(field, table.normal, table.offset)
    return largest_components(*visual_hull(field, resolution=0), 0, least)


def _filled(outline: np.ndarray) -> np.ndarray:
    """bool [H, W] without cracks of two pixels and without holes that are small beside the outline."""
    reach = _CLOSED + 1
    closed = binary_closing(np.pad(outline, reach), iterations=_CLOSED)[reach:-reach, reach:-reach] | outline
    holes, _ = label(~closed)
    return closed | (np.bincount(holes.ravel()) < _HOLES * closed.sum())[holes]
