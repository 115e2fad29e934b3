"""Flat parts of a hull that end in creases: where an opening may be covered by a lid that no outline shows open.

The hull spans the mouth of a vessel from rim to rim, by rays that graze both. So a lid is nearly flat, and the surface
turns sharply at its rim; a part of a curved side is flat only as far as one cares to look.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from exmesh_graph.geometry.adjacency import components, face_areas
from exmesh_graph.geometry.hull import Grid
from exmesh_graph.types.edges import Edges, edges_of

_FLAT, _WIDE = 14.0, 35.0  # degrees from the lid's own normal: within the first it is flat, up to the second its rim
_STABLE = 1.5  # the part within the wide angle over that within the narrow one, at most: else the surface just curves
_LEAST = 0.01  # of the surface
_SHARED = 0.3  # of a part's faces that a larger one has: then it is the same part
_SIDE = 3  # directions that parts are looked for in: so many from the middle of a cube's side to its edge


@dataclass(frozen=True)
class Lid:
    """faces int [K] of the surface, up to the rim; normal float64 [3], unit, outward; middle float64 [3]; radius of the
    disc that has the area of its flat part."""

    faces: np.ndarray
    normal: np.ndarray
    middle: np.ndarray
    radius: float


def lids(values: np.ndarray, grid: Grid, vertices: np.ndarray, faces: np.ndarray) -> list[Lid]:
    """The lids, largest first, of a field [I, J, K] that is positive inside, whose surface (vertices [V, 3],
    faces [F, 3]) is closed."""
    middles, areas, edges = vertices[faces].mean(1), face_areas(vertices, faces), edges_of(faces)
    normals = _normals(values, grid, middles)
    found: list[Lid] = []
    taken = np.zeros(len(faces), bool)
    for part in sorted(_flat_parts(normals, areas, faces, edges), key=lambda one: -areas[one].sum()):
        if taken[part].mean() > _SHARED:
            continue
        taken[part] = True
        normal = (normals[part] * areas[part, None]).sum(0)
        normal /= np.linalg.norm(normal)
        flat = _grown(part, _facing(normals, normal, _FLAT), faces, edges)
        wide = _grown(flat, _facing(normals, normal, _WIDE), faces, edges)
        size = areas[flat].sum()
        if size > 0 and areas[wide].sum() <= _STABLE * size:
            middle = (middles[flat] * areas[flat, None]).sum(0) / size
            found.append(Lid(wide, normal, middle, float(np.sqrt(size / np.pi))))
    return sorted(found, key=lambda lid: -lid.radius)


def _normals(values: np.ndarray, grid: Grid, places: np.ndarray) -> np.ndarray:
    """Unit, outward, float64 [P, 3]: of the field smoothed by a step, for triangles of marching cubes are uneven."""
    field = gaussian_filter(np.clip(values, -3 * grid.step, 3 * grid.step).astype(np.float64), 1.0)
    at = ((places - grid.origin) / grid.step).T
    rise = np.stack([map_coordinates(one, at, order=1, mode="nearest") for one in np.gradient(field)], axis=-1)
    return -rise / np.maximum(np.linalg.norm(rise, axis=1, keepdims=True), 1e-12)


def _flat_parts(normals: np.ndarray, areas: np.ndarray, faces: np.ndarray, edges: Edges) -> Iterator[np.ndarray]:
    """Connected faces that face one of many directions, int [K] each; those of neighbouring directions overlap."""
    steps = range(-_SIDE, _SIDE + 1)
    ways = np.array([way for way in itertools.product(steps, repeat=3) if max(map(abs, way)) == _SIDE], float)
    least = _LEAST * areas.sum()
    for way in ways / np.linalg.norm(ways, axis=1, keepdims=True):
        allowed = _facing(normals, way, _FLAT)
        if areas[allowed].sum() > least:
            part_of = _parts(allowed, faces, edges)
            for part in np.flatnonzero(np.bincount(part_of, areas * allowed) > least):
                yield np.flatnonzero(part_of == part)


def _facing(normals: np.ndarray, way: np.ndarray, degrees: float) -> np.ndarray:
    return normals @ way > np.cos(np.radians(degrees))


def _grown(part: np.ndarray, allowed: np.ndarray, faces: np.ndarray, edges: Edges) -> np.ndarray:
    """The connected faces among the allowed ones that hold most of `part`; none where none of it is allowed."""
    held = part[allowed[part]]
    if not len(held):
        return held
    part_of = _parts(allowed, faces, edges)
    return np.flatnonzero(part_of == np.bincount(part_of[held]).argmax())


def _parts(allowed: np.ndarray, faces: np.ndarray, edges: Edges) -> np.ndarray:
    """int [F]: faces of one number hang together through allowed faces; a face that is not allowed has its own."""
    return components(faces, edges, edges.interior & allowed[edges.faces].all(axis=1))
