"""Every ray against every triangle in float64: slow, plain, and the measure of the fast tracers."""

from __future__ import annotations

import numpy as np

from exmesh_graph.rays.tracer import MISS, Hits


class BruteTracer:
    """RayTracer by Moeller and Trumbore's test of all pairs; memory grows with rays x faces."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._corners = np.asarray(vertices, np.float64)[np.asarray(faces)]
        span = self._corners.reshape(-1, 3).max(axis=0) - self._corners.reshape(-1, 3).min(axis=0)
        self.radius = float(np.linalg.norm(span) / 2)

    def closest_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> Hits:
        o, d = np.asarray(origins, np.float64)[:, None], np.asarray(directions, np.float64)[:, None]
        a, b, c = (self._corners[None, :, i] for i in range(3))
        edge1, edge2 = b - a, c - a
        p = np.cross(d, edge2)
        determinant = (edge1 * p).sum(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / determinant
            s = o - a
            u = (s * p).sum(-1) * inverse
            q = np.cross(s, edge1)
            v = (d * q).sum(-1) * inverse
            t = (edge2 * q).sum(-1) * inverse
        limit = np.broadcast_to(np.asarray(t_max, np.float64), (len(o),))[:, None]
        with np.errstate(invalid="ignore"):
            valid = (determinant != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < limit)
        t = np.where(valid, t, np.inf)
        nearest = t.argmin(axis=1)
        rows = np.arange(len(t))
        hit = np.isfinite(t[rows, nearest])
        u, v = np.where(hit, u[rows, nearest], 0), np.where(hit, v[rows, nearest], 0)
        bary = np.stack([(1 - u - v) * hit, u, v], axis=1)
        return Hits(
            np.where(hit, nearest, MISS).astype(np.int32),
            t[rows, nearest].astype(np.float32),
            bary.astype(np.float32),
        )

    def any_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> np.ndarray:
        return self.closest_hit(origins, directions, t_max).face != MISS
