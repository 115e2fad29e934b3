"""Embree on the CPU. Its calls release the interpreter's lock, so rays are split over a few threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from exmesh_graph.errors import GeometryError, MissingLibraryError
from exmesh_graph.rays.tracer import MISS, Hits

_CHUNK = 1 << 17


class EmbreeTracer:
    """RayTracer on embreex.

    The mesh is moved to the origin and scaled to unit radius before it is handed over in float32, so a scene far
    from the origin, tiny or huge loses nothing to embree's arithmetic.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, threads: int | None = None) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingLibraryError("ray tracing on the CPU needs embreex", fix="pip install embreex") from error
        points = np.asarray(vertices, np.float64)
        if len(points) == 0 or len(faces) == 0:
            raise GeometryError("cannot trace rays against an empty mesh", expected="at least one face")
        if not np.isfinite(points).all():
            bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise GeometryError("a vertex is not finite", where=f"vertex {bad}", expected="finite coordinates")
        low, high = points.min(axis=0), points.max(axis=0)
        self._centre = (low + high) / 2
        self._radius = float(np.linalg.norm(high - low) / 2) or 1.0
        self._scene = EmbreeScene()
        # embreex keeps references to the arrays' memory only while building; ours stay alive with the tracer
        self._vertices = ((points - self._centre) / self._radius).astype(np.float32)
        self._faces = np.ascontiguousarray(faces, np.int32)
        self._mesh = TriangleMesh(self._scene, self._vertices, self._faces)
        self._threads = threads or len(os.sched_getaffinity(0))
        # the first query commits the scene; do it before threads share it
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), query="OCCLUDED")

    @property
    def radius(self) -> float:
        return self._radius

    def closest_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> Hits:
        parts = self._run(origins, directions, t_max, any_hit=False)
        face = np.concatenate([p["primID"] for p in parts]).astype(np.int32, copy=False)
        hit = face != MISS
        t = np.where(hit, np.concatenate([p["tfar"] for p in parts]), np.float32(np.inf))
        u = np.concatenate([p["u"] for p in parts]) * hit
        v = np.concatenate([p["v"] for p in parts]) * hit
        return Hits(face, t.astype(np.float32, copy=False), np.stack([(1 - u - v) * hit, u, v], axis=1))

    def any_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> np.ndarray:
        return np.concatenate(self._run(origins, directions, t_max, any_hit=True)) != MISS

    def _run(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray, any_hit: bool) -> list:
        count = len(origins)
        limits = np.broadcast_to(np.asarray(t_max, np.float32), (count,))

        def trace(start: int) -> Any:
            part = slice(start, min(start + _CHUNK, count))
            o = ((origins[part] - self._centre) / self._radius).astype(np.float32)
            # unit directions: embree's tolerances assume them; t is turned back into world units below
            length = np.linalg.norm(directions[part], axis=1)
            d = (directions[part] / length[:, None]).astype(np.float32)
            scale = (self._radius / length).astype(np.float32)
            far = np.minimum(limits[part] / scale, np.float32(1e30))
            if any_hit:
                return self._scene.run(o, d, dists=far, query="OCCLUDED")
            found = self._scene.run(o, d, dists=far, output=True)
            found["tfar"] = found["tfar"] * scale
            return found

        starts = range(0, max(count, 1), _CHUNK)
        if len(starts) == 1 or self._threads == 1:
            return [trace(start) for start in starts]
        with ThreadPoolExecutor(self._threads) as pool:
            return list(pool.map(trace, starts))
