"""Rows of ray tracing and shadow rays."""

from __future__ import annotations

import numpy as np

from benchmarks.brute_rays import BruteTracer
from benchmarks.rays import CUBE, CUBE_FACES, box_rays, escapes, surface_rays
from benchmarks.stability.table import Reached, row
from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.rays import make_ray_tracer, offset_origins
from exmesh_graph.rays.warp_bvh import WarpTracer


@row(
    "rays",
    "closed box from inside, half through edges and vertices",
    "escapes of 200 000 rays, embree and warp",
    high=0,
)
def box() -> Reached:
    origins, directions = box_rays(200_000, 0)
    tracers = (make_ray_tracer(CUBE, CUBE_FACES), WarpTracer(CUBE, CUBE_FACES, "cpu"))
    return Reached(float(sum((~tracer.any_hit(origins, directions)).sum() for tracer in tracers)))


@row("rays", "the same, long", "escapes of 10 million rays, embree and warp", high=0, slow=True)
def box_long() -> Reached:
    return Reached(sum(escapes(10_000_000).values()))


@row("rays", "rays leave a surface: scaled by 1e-3, 1 and 1e3, shifted by 1e3", "share that meets its own face", high=0)
def self_intersection() -> Reached:
    """Points and vertices in float32, as a renderer has them; embree and warp."""
    worst = 0.0
    for scale, shift in ((1, 0), (1e-3, 0), (1e3, 0), (1, 1e3)):
        points, faces = _bumps()
        vertices = (points * scale + shift).astype(np.float32)
        rng = np.random.default_rng(0)
        face = rng.integers(0, len(faces), 20_000)
        weight = rng.dirichlet([1, 1, 1], 20_000).astype(np.float32)
        start = (vertices[faces[face]] * weight[..., None]).sum(axis=1)
        normal = face_normals(vertices.astype(np.float64), faces)[face]
        directions = rng.normal(size=(20_000, 3))
        directions *= np.sign((directions * normal).sum(axis=1, keepdims=True))
        for tracer in (make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, "cpu")):
            hits = tracer.closest_hit(offset_origins(start, normal, tracer.radius), directions)
            worst = max(worst, float((hits.face == face).mean()))
    return Reached(worst)


@row(
    "rays", "visibility of that surface scaled by 1e-3 and 1e3, shifted by 1e3", "share of rays that change", high=1e-4
)
def same_visibility() -> Reached:
    points, faces = _bumps()
    rng = np.random.default_rng(1)
    face, weight = rng.integers(0, len(faces), 50_000), rng.dirichlet([1, 1, 1], 50_000)
    directions = rng.normal(size=(50_000, 3))
    seen = []
    for scale, shift in ((1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1e3, 1e3), (1.0, 1e3)):
        vertices = points * scale + shift
        normal = face_normals(vertices, faces)[face]
        side = np.sign((directions * normal).sum(axis=1, keepdims=True))
        tracer = make_ray_tracer(vertices, faces)
        origins = offset_origins((vertices[faces[face]] * weight[..., None]).sum(axis=1), normal * side, tracer.radius)
        seen.append(tracer.any_hit(origins, directions))
    return Reached(max(float((other != seen[0]).mean()) for other in seen[1:]))


@row("rays", "two tracers, one scene: embree and warp on 200 000 shadow rays", "share on which they differ", high=1e-4)
def agreement() -> Reached:
    points, faces = _bumps()
    origins, directions = surface_rays(points, faces, 200_000)
    first, second = make_ray_tracer(points, faces), WarpTracer(points, faces, "cpu")
    return Reached(float((first.any_hit(origins, directions) != second.any_hit(origins, directions)).mean()))


@row("rays", "random soup, embree and warp against all pairs in float64", "share on which they differ", high=2e-3)
def soup() -> Reached:
    rng = np.random.default_rng(3)
    vertices, faces = rng.normal(size=(60, 3)), rng.integers(0, 60, (60, 3)).astype(np.int32)
    origins, directions = rng.normal(size=(2, 5000, 3)) * 2
    exact = BruteTracer(vertices, faces).closest_hit(origins, directions).face
    tracers = (make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, "cpu"))
    return Reached(max(float((t.closest_hit(origins, directions).face != exact).mean()) for t in tracers))


@row("rays", "open hemisphere: both sides of a face stop a ray", "free rays from its pole inside", low=0.49, high=0.51)
def two_sided() -> Reached:
    points, faces = _sphere(40)
    upper = faces[(points[faces][..., 1] > -1e-9).all(axis=1)]
    directions = np.random.default_rng(0).normal(size=(100_000, 3))
    inside = np.broadcast_to([0.0, 0.5, 0.0], directions.shape)
    free = ~make_ray_tracer(points, upper).any_hit(inside, directions)
    # the opening seen from half the radius above it: a cone with cos = 0.5 / sqrt(1.25)
    expected = 0.5 * (1 - 0.5 / np.sqrt(1.25))
    return Reached(0.5 * float(free.mean()) / expected)


def _sphere(rings: int) -> tuple[np.ndarray, np.ndarray]:
    lat, lon = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rings + 1),
        np.linspace(-np.pi, np.pi, 2 * rings, endpoint=False),
        indexing="ij",
    )
    points = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    k = (j + 1) % (2 * rings)
    a, b, c, d = (line * 2 * rings + column for line, column in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
    # without the zero-area faces at the poles
    faces = [np.stack([a, b, c], -1)[1:], np.stack([a, c, d], -1)[:-1]]
    return points, np.concatenate([part.reshape(-1, 3) for part in faces]).astype(np.int32)


def _bumps() -> tuple[np.ndarray, np.ndarray]:
    points, faces = _sphere(48)
    return points * (1 + 0.2 * np.sin(9 * points[:, :1]) * np.sin(7 * points[:, 1:2])), faces
