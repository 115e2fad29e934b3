"""What stands amidst the views of a fused surface: without lumps that views look through, and without its table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import boundary_edges, face_areas, without_unused
from exmesh_graph.geometry.clean import largest_components
from exmesh_graph.masks.pinhole import pixels_of
from exmesh_graph.masks.plane import Plane, plane_below
from exmesh_graph.types import DepthMaps, Views

_VOXELS = 1.5
"""Half the thickness of a table, which stereo's noise gives it."""
_SKIRT = 3.0
_TOLERANCE = 0.02


@dataclass(frozen=True)
class Standing:
    """What `standing` leaves of a surface.

    vertices, faces  float32 [V, 3], int32 [F, 3], open; of `object_of_depths` closed, counter-clockwise from outside
    table            the plane that it stands on, None where there is none
    removed          whether that was taken away
    shares           of the whole surface's area: `lumps` that views look through, `table`, `beside` what too few
                     pictures hold, or small parts; `object` what is left
    apart            of what there is without lumps, table and small parts, the share that enough pictures hold
    """

    vertices: np.ndarray
    faces: np.ndarray
    table: Plane | None
    removed: bool
    shares: dict[str, float]
    apart: float


def standing(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Views,
    depths: DepthMaps,
    voxel: float,
    table: Literal["auto", "remove", "keep"] = "auto",
    least_part: float = 0.05,
    *,
    shown: float = 0.0,
    seed: int = 0,
) -> Standing:
    """The surface [V, 3], [F, 3] that `depths` of `views` were fused to in voxels of `voxel`, but for its surroundings.

    Parts stay from the share `least_part` of the largest one's area on, and what a share `shown` of the pictures holds.
    Raises GeometryError where nothing is left, and for table: remove where no table was found.
    """
    whole, shares = float(face_areas(vertices, faces).sum()), {}
    held = ~looked_through(vertices, views, depths)
    faces, shares["lumps"] = _less(vertices, faces, held[faces].all(axis=1), whole)
    plane = plane_below(vertices, faces, views.camera_to_world[:, :3, 3], _VOXELS * voxel, seed)
    if table == "remove" and plane is None:
        raise GeometryError(
            "no plane was found that the object stands on and the cameras look down on", where="init.object",
            fix="set table: auto, or keep",
        )  # fmt: skip
    removed = plane is not None and (table == "remove" or (table == "auto" and plane.is_table))
    if removed and plane is not None:
        above = plane.height(vertices[faces].mean(axis=1)) > _VOXELS * voxel
        faces, shares["table"] = _less(vertices, faces, above, whole)
    held = (shown_by(vertices, views) >= shown)[faces].all(axis=1)
    faces, beside = _less(vertices, faces, held, whole)
    if len(faces) == 0:
        raise GeometryError(
            f"nothing is left of the surface that the depth maps show: {said({**shares, 'beside': beside})}",
            where="init.object", expected="a painted object amidst the views",
            fix="set table: keep, or give masks (mask.files)",
        )  # fmt: skip
    vertices, faces = largest_components(*without_unused(vertices, faces), 0, least_part)
    shares["object"] = float(face_areas(vertices, faces).sum()) / whole
    shares["beside"] = 1 - sum(shares.values())
    apart = shares["object"] / (shares["object"] + beside)
    if removed and plane is not None:
        vertices, faces = down_to(plane, vertices, faces, _SKIRT * voxel)
    return Standing(vertices, faces, plane, removed, shares, apart)


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
    place, z = pixels_of(points, views.intrinsics[view], views.world_to_camera[view])
    row, column = np.floor(place + 0.5)
    there = (row >= 0) & (row < views.height) & (column >= 0) & (column < views.width)
    return np.where(there, row, -1).astype(int), np.where(there, column, -1).astype(int), z


def _less(vertices: np.ndarray, faces: np.ndarray, kept: np.ndarray, whole: float) -> tuple[np.ndarray, float]:
    """(the faces that are kept, share of the others of the area `whole`)."""
    return faces[kept], float(face_areas(vertices, faces[~kept]).sum()) / whole


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


def said(shares: dict[str, float]) -> str:
    """Shares of the surface as text."""
    return ", ".join(f"{name} {share:.0%}" for name, share in shares.items())
