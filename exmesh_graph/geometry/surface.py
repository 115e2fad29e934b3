"""Points on a triangle mesh: the nearest one, and ones drawn uniformly by area."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Nearest point [N, 3] of each triangle [N, 3, 3] to its point [N, 3]."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    area = np.einsum("ni,ni->n", normal, normal)
    to = points - a
    s = np.einsum("ni,ni->n", np.cross(to, c - a), normal)
    t = np.einsum("ni,ni->n", np.cross(b - a, to), normal)
    inside = (s >= 0) & (t >= 0) & (s + t <= area) & (area > 0)
    safe = np.where(area > 0, area, 1)[:, None]
    best = points - normal * np.einsum("ni,ni->n", to, normal)[:, None] / safe
    distance = np.where(inside, ((best - points) ** 2).sum(1), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        length = np.einsum("ni,ni->n", along, along)
        u = np.clip(np.einsum("ni,ni->n", points - start, along) / np.where(length > 0, length, 1), 0, 1)
        foot = start + u[:, None] * along
        squared = ((foot - points) ** 2).sum(1)
        nearer = squared < distance
        best, distance = np.where(nearer[:, None], foot, best), np.where(nearer, squared, distance)
    return best


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points float64 [count, 3], face int64 [count], barycentric float64 [count, 3]), stratified over the area.

    The i-th point lies in the i-th of `count` equal shares of the area, in face order, so that every face gets its
    share to within one point; inside a face (1 - sqrt(u), sqrt(u)(1 - v), sqrt(u) v) is uniform.
    Raises GeometryError for a mesh without area.
    """
    areas = face_areas(vertices, faces)
    total = areas.sum() if len(areas) else 0.0
    if not np.isfinite(total) or total <= 0:
        raise GeometryError(f"cannot sample a mesh of area {total:g}", expected="faces with finite, positive area")
    generator = np.random.default_rng(seed)
    positions = (np.arange(count) + generator.random(count)) * (total / count)
    face = np.minimum(np.searchsorted(np.cumsum(areas), positions, side="right"), len(faces) - 1)
    root, v = np.sqrt(generator.random(count)), generator.random(count)
    bary = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points = np.einsum("pk,pki->pi", bary, vertices[faces[face]].astype(np.float64))
    return points, face, bary
