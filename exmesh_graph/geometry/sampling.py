"""Points drawn on a triangle mesh, uniform by area."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas


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
