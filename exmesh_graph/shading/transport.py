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
from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.gpu.cores import share
from exmesh_graph.rays import MISS, RayTracer, make_ray_tracer, offset_origins
from exmesh_graph.shading.lattice import Lattice, build_lattice, locate
from exmesh_graph.shading.point_sets import fibonacci_sphere
from exmesh_graph.types import Transport

if TYPE_CHECKING:
    from exmesh_graph.shading.settings import TransportSettings

#: How far ray origins move from their lattice point towards the centre of the face that carries it: rays that start
#: exactly on a crease or in a corner meet the neighbouring face at distance zero.
INWARD = 0.02


def choose_subdivision(vertex_count: int, face_count: int, points: int) -> int:
    """The smallest subdivision whose lattice has at least `points` points (at most 16)."""
    edges = face_count * 3 // 2
    for n in range(1, 17):
        if vertex_count + edges * (n - 1) + face_count * (n - 1) * (n - 2) // 2 >= points:
            return n
    return 16


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
    if casts is None or not casts.any():
        subdivision = choose_subdivision(len(vertices), len(faces), settings.points)
    else:  # what casts no light does not change how densely the rest is sampled
        subdivision = choose_subdivision(len(np.unique(faces[casts])), int(casts.sum()), settings.points)
    tracer = make_ray_tracer(vertices, faces, casts=casts)
    return trace_transport(vertices, faces, settings.directions, subdivision, tracer, progress=progress)


def trace_transport(
    vertices: np.ndarray,
    faces: np.ndarray,
    directions: int = 128,
    subdivision: int = 1,
    tracer: RayTracer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Transport:
    """Trace `directions` rays from every lattice point of the mesh; those below the point's horizon are left out.

    A direction above the shading normal's horizon but below the carrying face's own is blocked.
    """
    tracer = tracer or make_ray_tracer(vertices, faces)
    lattice = build_lattice(vertices, faces, subdivision)
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
        subdivision=subdivision,
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


def with_bounces(light: Transport, bounces: int, secondary_material: bool = True) -> Transport:
    """`light` with the interreflection operator M built and `bounces` of it switched on.

    secondary_material  hits send their own colour; else the receiving point's colour stands in
    """
    cosine = (light.normals[light.hit_point] * light.directions[light.hit_direction]).sum(axis=1)
    start, point, weight = gathered_hits(light, np.maximum(cosine, 0) * (4 * math.pi / len(light.directions)))
    return dataclasses.replace(
        light,
        bounces=bounces,
        secondary_material=secondary_material,
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
    column, weight = locate(light.face_points, light.subdivision, light.hit_face, bary)
    count = len(light.points)
    value = (weight * measure[:, None]).reshape(-1).astype(np.float64)
    row = np.repeat(light.hit_point, 3)
    # rays of one point that meet the same lattice point share an entry
    matrix = coo_matrix((value, (row, column.reshape(-1))), shape=(count, count)).tocsr()
    return matrix.indptr, matrix.indices, matrix.data.astype(np.float32)


def check_fits(light: Transport, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise GeometryError unless `light` was traced on this very mesh."""
    corners = light.subdivision
    local = [0, (corners + 1) * (corners + 2) // 2 - 1, corners]  # corner 0, corner 1 (i = n), corner 2 (j = n)
    same = len(light.face_points) == len(faces) and np.allclose(
        light.points[light.face_points[:, local]], vertices[faces], rtol=0, atol=1e-5
    )
    if not same:
        raise GeometryError(
            "the light transport was traced on another mesh than the one it is used with",
            expected=f"{len(faces)} faces with the same corners; it has {len(light.face_points)} faces",
            fix="wire the same output into transport.direct's `mesh` and stage2.fit's `carrier`",
        )
