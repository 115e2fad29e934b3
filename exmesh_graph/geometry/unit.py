"""A mesh about its centre and at unit radius: what hierarchies of float32 are built of."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import GeometryError


def unit_mesh(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The mesh's vertices about its centre and at unit radius, float32 [V, 3]; its centre [3]; its radius.

    So a scene far from the origin, tiny or huge loses nothing to float32. Raises GeometryError for an empty mesh or
    vertices that are not finite.
    """
    points = np.asarray(vertices, np.float64)
    if len(points) == 0 or len(faces) == 0:
        raise GeometryError("an empty mesh has neither rays nor distances", expected="at least one face")
    if not np.isfinite(points).all():
        bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise GeometryError("a vertex is not finite", where=f"vertex {bad}", expected="finite coordinates")
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    radius = float(np.linalg.norm(high - low) / 2) or 1.0
    return ((points - centre) / radius).astype(np.float32), centre, radius
