"""The object among what depth maps show: fused, without what views look through, without its table, closed.

Depth maps that were found without masks hold the object, the ground it stands on, pieces of the surroundings and lumps
in the air. What is left of them is drawn into each view; the visual hull of these outlines is closed and rough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_closing, label, uniform_filter

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import boundary_edges, face_areas, without_unused
from exmesh_graph.geometry.clean import largest_components
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.geometry.settings import TsdfSettings
from exmesh_graph.geometry.tsdf import fuse
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.train_size import reduced
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.plane import Plane, plane_below
from exmesh_graph.masks.settings import ObjectSettings
from exmesh_graph.masks.wide import brought_back, widened
from exmesh_graph.types import DepthMaps, Views

_VOXELS = 1.5
"""Half the thickness of a table, which stereo's noise gives it."""
_SKIRT = 3.0
_TOLERANCE = 0.02
_SHOWN = 0.8
_HOLES = 0.002
_CLOSED = 2
_WINDOW = 3


@dataclass(frozen=True)
class Found:
    """What `object_of_depths` finds.

    vertices, faces  float32 [V, 3], int32 [F, 3], closed, counter-clockwise from outside, in the world of the views
    table            the plane that it stands on, None where there is none
    removed          whether that was taken away
    shares           of the fused surface's area: `lumps` that views look through, `table`, `beside` what most views'
                     pictures do not hold, or small parts; `object` what is left
    apart            of what there is without lumps, table and small parts, the share that most views' pictures hold: a
                     surface that goes on beyond the pictures has little
    """

    vertices: np.ndarray
    faces: np.ndarray
    table: Plane | None
    removed: bool
    shares: dict[str, float]
    apart: float


def object_of_depths(
    views: Views, depths: DepthMaps, settings: ObjectSettings | None = None, *, side: int = 400, seed: int = 0
) -> Found:
    """The object that stands amidst `views`, by their depth maps, inside the sphere of radius `settings.reach`.

    Pictures and maps are looked at reduced to a longer side of at most `side` pixels, which the sizes of windows and
    cracks here are meant for. Raises DataError where views and maps do not belong together or nothing left of the
    surface is common to the views, GeometryError where the depth maps give no surface, where nothing is left of it, and
    for table: remove where no table was found.
    """
    settings = settings or ObjectSettings()
    reach, voxel = settings.reach, 2.0 / settings.resolution
    depths.require_of(views, "init.object")
    factor = max(1, math.ceil(max(views.width, views.height) / side))
    wide = widened(reduced(views, factor), reach)
    maps = structured(wide, brought_back(thinned(depths, wide, factor), 1 / reach), settings.least_structure)
    fused = TsdfSettings(resolution=settings.resolution, masked=False, truncation=6, min_weight=2, radius=1)
    vertices, faces = fuse(wide, maps, fused)
    whole, shares = float(face_areas(vertices, faces).sum()), {}
    held = ~looked_through(vertices, wide, maps)
    faces, shares["lumps"] = _less(vertices, faces, held[faces].all(axis=1), whole)
    table = plane_below(vertices, faces, wide.camera_to_world[:, :3, 3], _VOXELS * voxel, seed)
    if settings.table == "remove" and table is None:
        raise GeometryError(
            "no plane was found that the object stands on and the cameras look down on", where="init.object",
            fix="set table: auto, or keep",
        )  # fmt: skip
    removed = table is not None and (settings.table == "remove" or (settings.table == "auto" and table.is_table))
    if removed and table is not None:
        above = table.height(vertices[faces].mean(axis=1)) > _VOXELS * voxel
        faces, shares["table"] = _less(vertices, faces, above, whole)
    held = (shown_by(vertices, wide) >= _SHOWN)[faces].all(axis=1)
    faces, beside = _less(vertices, faces, held, whole)
    if len(faces) == 0:
        raise GeometryError(
            f"nothing is left of the surface that the depth maps show: {said({**shares, 'beside': beside})}",
            where="init.object", expected="a painted object amidst the views",
            fix="set table: keep, or give masks (mask.files)",
        )  # fmt: skip
    vertices, faces = largest_components(*without_unused(vertices, faces), 0, settings.least_part)
    shares["object"] = float(face_areas(vertices, faces).sum()) / whole
    shares["beside"] = 1 - sum(shares.values())
    if removed and table is not None:
        vertices, faces = down_to(table, vertices, faces, _SKIRT * voxel)
    vertices, faces = _closed(vertices, faces, wide, table if removed else None, settings.least_part)
    apart = shares["object"] / (shares["object"] + beside)
    return Found(vertices * np.float32(reach), faces, table, removed, shares, apart)


def down_to(table: Plane, vertices: np.ndarray, faces: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
    """The open mesh with walls from its rim down to the plane, where the rim is at most so high above it.

    Taking a table away takes the feet of what stands on it along.
    """
    rim = boundary_edges(faces)
    low = (table.height(vertices) <= most)[rim].all(axis=1)
    used, index = np.unique(rim[low], return_inverse=True)
    if len(used) == 0:
        return vertices, faces
    feet = vertices[used] - table.height(vertices[used])[:, None] * table.normal
    a, b = rim[low].T
    c, d = (len(vertices) + index.reshape(-1, 2)).T
    walls = np.concatenate([np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)])
    return (
        np.concatenate([vertices, feet]).astype(np.float32),
        np.concatenate([faces, walls]).astype(np.int32),
    )


def thinned(depths: DepthMaps, views: Views, factor: int) -> DepthMaps:
    """Every `factor`-th pixel of the maps, of the middle of each square that became a pixel of the reduced `views`."""
    rows, columns = (factor // 2 + factor * np.arange(count) for count in (views.height, views.width))
    return replace(depths, depth=depths.depth[:, rows[:, None], columns])


def structured(views: Views, depths: DepthMaps, least: float) -> DepthMaps:
    """The depth maps without the pixels around which the picture is flat (deviation of 3 x 3 below `least`).

    Windows of stereo carry the object's depth onto a flat background beside it.
    """
    kept = depths.depth.copy()
    for view in range(len(views)):
        grey = linear_to_srgb(np.clip(np.asarray(views.images[view]), 0, 1)).mean(axis=-1, dtype=np.float64)
        mean, square = (uniform_filter(part, _WINDOW, mode="nearest") for part in (grey, grey**2))
        kept[view][square - mean**2 < least**2] = 0
    return replace(depths, depth=kept)


def looked_through(points: np.ndarray, views: Views, depths: DepthMaps) -> np.ndarray:
    """bool [P]: more views measure a depth behind the point [P, 3], in whose way it would be, than at it."""
    through, at = np.zeros(len(points), int), np.zeros(len(points), int)
    for view in range(len(views)):
        row, column, z = _pixels(points, views, view)
        there = row >= 0
        depth = depths.depth[view][np.where(there, row, 0), np.where(there, column, 0)]
        known = there & (depth > 0)
        through += known & (z < (1 - _TOLERANCE) * depth)
        at += known & (np.abs(z - depth) <= _TOLERANCE * depth)
    return (through > at) & (through >= 2)


def shown_by(points: np.ndarray, views: Views) -> np.ndarray:
    """float64 [P], the share of the views in whose pictures the points [P, 3] lie, hidden or not."""
    return np.mean([_pixels(points, views, view)[0] >= 0 for view in range(len(views))], axis=0)


def _pixels(points: np.ndarray, views: Views, view: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row [P], column [P], depth [P]) of points [P, 3]; -1, -1 where they are not in the picture."""
    matrix = views.intrinsics[view] @ views.world_to_camera[view][:3]
    image = points @ matrix[:, :3].T + matrix[:, 3]
    z = image[:, 2]
    place = np.floor(image[:, :2] / np.maximum(z, 1e-6)[:, None])
    there = (z > 1e-6) & (place >= 0).all(axis=1) & (place < (views.width, views.height)).all(axis=1)
    column, row = np.where(there[:, None], place, -1).astype(int).T
    return row, column, z


def _less(vertices: np.ndarray, faces: np.ndarray, kept: np.ndarray, whole: float) -> tuple[np.ndarray, float]:
    """(the faces that are kept, share of the others of the area `whole`)."""
    return faces[kept], float(face_areas(vertices, faces[~kept]).sum()) / whole


def _closed(
    vertices: np.ndarray, faces: np.ndarray, views: Views, table: Plane | None, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """The hull of the open surface's outlines, above the table, without small parts."""
    outlines = np.stack([_filled(one) for one in drawn_outlines(vertices, faces, views)])
    seen = outlines.any(axis=(1, 2))
    field = SilhouetteField.from_masks(outlines[seen], views.intrinsics[seen], views.world_to_camera[seen])
    if table is not None:
        field = _Grounded(
            field.distances, field.intrinsics, field.world_to_camera, field.wrong_masks, table.normal, table.offset
        )
    return largest_components(*visual_hull(field, resolution=0), 0, least)


@dataclass(frozen=True)
class _Grounded(SilhouetteField):
    """The hull's field above a plane: normal [3] and offset as in Plane."""

    normal: np.ndarray | None = None
    offset: float = 0.0

    def __call__(self, points: np.ndarray, floor: float = -np.inf) -> np.ndarray:
        height = (points @ np.asarray(self.normal) - self.offset).astype(np.float32)
        return np.minimum(super().__call__(points, floor), height)


def _filled(outline: np.ndarray) -> np.ndarray:
    """bool [H, W] without cracks of two pixels and without holes that are small beside the outline."""
    reach = _CLOSED + 1
    closed = binary_closing(np.pad(outline, reach), iterations=_CLOSED)[reach:-reach, reach:-reach] | outline
    holes, _ = label(~closed)
    return closed | (np.bincount(holes.ravel()) < _HOLES * closed.sum())[holes]


def said(shares: dict[str, float]) -> str:
    """Shares of the surface as text."""
    return ", ".join(f"{name} {share:.0%}" for name, share in shares.items())
