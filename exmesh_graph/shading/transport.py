"""Diffuse light transport of a frozen mesh, traced once (types.Transport): visibility, and where the mesh sees itself.

K equal-area directions w_k, a ray along each from every point of a lattice on the surface. `shading.operators` turns
them into irradiance.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas, face_normals
from exmesh_graph.gpu.cores import share
from exmesh_graph.rays import MISS, RayTracer, make_ray_tracer, offset_origins
from exmesh_graph.shading.lattice import Lattice, build_lattice, face_starts, locate, points_of_face
from exmesh_graph.shading.point_sets import fibonacci_sphere
from exmesh_graph.types import Transport

if TYPE_CHECKING:
    from exmesh_graph.shading.settings import TransportSettings

#: How far ray origins move from their lattice point towards the centre of the face that carries it: rays that start
#: exactly on a crease or in a corner meet the neighbouring face at distance zero.
INWARD = 0.02


#: Steps along an edge at most.
MOST_STEPS = 256


def choose_steps(vertices: np.ndarray, faces: np.ndarray, points: int, counted: np.ndarray | None = None) -> np.ndarray:
    """Steps per edge of each face, int32 [F], powers of two: as even a spacing as gives at least `points` points, and
    no wider than that of `points` points spread over the surface.

    A face's size is the geometric mean of its longest edge and of the side of a square of its area: by area alone a
    sliver had too few points along its length, by length alone too many of all.
    counted  bool [F], the faces that make up the count (None: all). The others are spaced alike, or wider where they
             would have many more points than that: they change none of the counted ones.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    size = np.sqrt(longest * np.sqrt(2 * face_areas(vertices, faces)))
    levels = np.log2(np.maximum(size, 1e-12 * max(float(size.max()), 1e-30)))
    if counted is None or counted.all():
        return _steps_at(levels, _spacing(levels, faces, points))
    mine = _spacing(levels[counted], faces[counted], points)
    others = max(mine, _spacing(levels[~counted], faces[~counted], points))
    return np.where(counted, _steps_at(levels, mine), _steps_at(levels, others))


def _spacing(levels: np.ndarray, faces: np.ndarray, points: int) -> float:
    """The widest spacing (log2, in eighths below the largest face's) that gives at least `points` points, or that of
    `points` points spread evenly, where it is less: a mesh of finely cut parts and large flat faces has as many corners
    without one of them on these faces.
    """
    even = 0.5 * math.log2(float(np.exp2(2 * levels).sum()) / (2 * points))  # a point has two faces of a lattice
    corner_points = len(np.unique(faces))

    def count(spacing: float) -> int:
        n = _steps_at(levels, spacing).astype(np.int64)
        return corner_points + int((3 * (n - 1) // 2 + (n - 1) * (n - 2) // 2).sum())

    largest, below = float(levels.max()), 8 * math.ceil(float(np.ptp(levels)) + math.log2(MOST_STEPS) + 2)
    spacings = largest + 1 - np.arange(below) / 8
    found = int(np.searchsorted([count(spacing) >= points for spacing in spacings], True))
    return min(even, float(spacings[min(found, below - 1)]))


def _steps_at(levels: np.ndarray, spacing: float) -> np.ndarray:
    return np.exp2(np.clip(np.round(levels - spacing), 0, math.log2(MOST_STEPS))).astype(np.int32)


def direct_transport(
    vertices: np.ndarray,
    faces: np.ndarray,
    settings: TransportSettings,
    progress: Callable[[int, int], None] | None = None,
    casts: np.ndarray | None = None,
) -> Transport:
    """The transport without bounces, as densely as `settings` (shading.settings) ask.

    casts  bool [F], the faces that stop light and send it back (None: all); all of them receive it
    """
    # what casts no light does not change how densely the rest is sampled
    steps = choose_steps(vertices, faces, settings.points, casts if casts is not None and casts.any() else None)
    tracer = make_ray_tracer(vertices, faces, casts=casts)
    return trace_transport(vertices, faces, settings.directions, steps, tracer, progress=progress)


def trace_transport(
    vertices: np.ndarray,
    faces: np.ndarray,
    directions: int = 128,
    steps: int | np.ndarray = 1,
    tracer: RayTracer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Transport:
    """Trace `directions` rays from every lattice point of the mesh; those below the point's horizon are left out.

    `steps`: of the lattice, one number or one for each face.
    A direction above the shading normal's horizon but below the carrying face's own is blocked.
    """
    tracer = tracer or make_ray_tracer(vertices, faces)
    lattice = build_lattice(vertices, faces, steps)
    if directions > np.iinfo(np.uint16).max:
        raise GeometryError(f"{directions} directions", expected="at most 65535")
    sky = fibonacci_sphere(directions)
    flat = face_normals(vertices, faces)
    origins = lattice_origins(lattice, vertices, faces, tracer.radius)
    chunk = max(1, (1 << 20) // directions)
    done, told = 0, threading.Lock()

    def one(start: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        nonlocal done
        part = slice(start, start + chunk)
        traced = _trace_points(tracer, origins[part], lattice, flat, sky, start)
        if progress:
            with told:
                done += len(origins[part])
                progress(done, len(origins))
        return traced

    visible, hits = zip(*share(one, range(0, len(origins), chunk)), strict=True)
    hit_point, hit_direction, hit_face, hit_bary = (np.concatenate(column) for column in zip(*hits, strict=True))
    return Transport(
        directions=sky.astype(np.float32),
        steps=lattice.steps,
        face_points=lattice.face_points,
        points=lattice.points.astype(np.float32),
        normals=lattice.normals.astype(np.float32),
        point_face=lattice.point_face,
        point_bary=lattice.point_bary.astype(np.float32),
        visible=np.concatenate(visible),
        hit_point=hit_point,
        hit_direction=hit_direction,
        hit_face=hit_face,
        hit_bary=hit_bary,
    )


def lattice_origins(light: Lattice | Transport, vertices: np.ndarray, faces: np.ndarray, radius: float) -> np.ndarray:
    """Where the rays of the lattice points start, float64 [P, 3]; `radius` is the tracer's."""
    carrying, corners = light.point_face, np.asarray(vertices, np.float64)[faces]
    inner = light.points + INWARD * (corners[carrying].mean(axis=1) - light.points)
    return offset_origins(inner, face_normals(vertices, faces)[carrying], radius)


def _trace_points(
    tracer: RayTracer, origins: np.ndarray, lattice: Lattice, flat: np.ndarray, sky: np.ndarray, start: int
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    part = slice(start, start + len(origins))
    above = (lattice.normals[part] @ sky.T > 0) & (flat[lattice.point_face[part]] @ sky.T > 0)
    point, direction = np.nonzero(above)
    hits = tracer.closest_hit(origins[point], sky.astype(np.float32)[direction])
    free = np.zeros(above.shape, bool)
    free[above] = hits.face == MISS
    met = np.flatnonzero(hits.face != MISS)
    front = met[(flat[hits.face[met]] * sky[direction[met]]).sum(axis=1) < 0]
    return np.packbits(free, axis=1, bitorder="little"), (
        (point[front] + start).astype(np.int32),
        direction[front].astype(np.uint16),
        hits.face[front],
        hits.bary[front, 1:],
    )


def with_bounces(light: Transport, bounces: int, secondary_material: bool = True, deeper: bool = False) -> Transport:
    """`light` with the interreflection operator M built and `bounces` of it switched on.

    secondary_material  hits send their own colour; else the receiving point's colour stands in
    deeper              the bounces beyond these count too
    """
    cosine = (light.normals[light.hit_point] * light.directions[light.hit_direction]).sum(axis=1)
    start, point, weight = gathered_hits(light, np.maximum(cosine, 0) * (4 * math.pi / len(light.directions)))
    return dataclasses.replace(
        light,
        bounces=bounces,
        secondary_material=secondary_material,
        deeper=deeper,
        gather_start=start.astype(np.int32),
        gather_point=point.astype(np.int32),
        gather_weight=weight,
    )


def gathered_hits(light: Transport, measure: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The hits as a sparse matrix [P, P] from the points around a hit to the point that sees it.

    measure [H], what each hit counts for. Returns (start [P + 1], column, weight float32) by rows (CSR).
    """
    from scipy.sparse import coo_matrix

    bary = np.concatenate([1 - light.hit_bary.sum(axis=1, keepdims=True), light.hit_bary], axis=1)
    column, weight = locate(light, light.hit_face, bary)
    count = len(light.points)
    value = (weight * measure[:, None]).reshape(-1).astype(np.float64)
    row = np.repeat(light.hit_point, 3)
    # rays of one point that meet the same lattice point share an entry
    matrix = coo_matrix((value, (row, column.reshape(-1))), shape=(count, count)).tocsr()
    return matrix.indptr, matrix.indices, matrix.data.astype(np.float32)


def check_fits(light: Transport, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise GeometryError unless `light` was traced on this very mesh."""
    same = len(light.steps) == len(faces)
    if same:
        n = light.steps.astype(np.int64)
        local = np.stack([np.zeros_like(n), points_of_face(n) - 1, n], axis=1)  # corners 0, 1 (i = n) and 2 (j = n)
        found = light.points[light.face_points[face_starts(light.steps)[:, None] + local]]
        same = np.allclose(found, vertices[faces], rtol=0, atol=1e-5)
    if not same:
        raise GeometryError(
            "the light transport was traced on another mesh than the one it is used with",
            expected=f"{len(faces)} faces with the same corners; it has {len(light.steps)} faces",
            fix="wire the same output into transport.direct's `mesh` and stage2.fit's `carrier`",
        )
