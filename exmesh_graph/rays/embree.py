"""Embree on the CPU. Its calls release the interpreter's lock, so rays are split over the cores (gpu.cores)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from exmesh_graph.errors import MissingLibraryError
from exmesh_graph.geometry.unit import unit_mesh
from exmesh_graph.rays.tracer import MISS, Hits

#: Rays per call of embree, at least and at most.
_LEAST, _MOST = 1 << 12, 1 << 16
#: What embree is told instead of infinity.
_FAR = np.float32(1e30)


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
        # embreex keeps references to the arrays' memory only while building; ours stay alive with the tracer
        self._vertices, self._centre, self._radius = unit_mesh(vertices, faces)
        self._scene = EmbreeScene()
        self._faces = np.ascontiguousarray(faces, np.int32)
        self._mesh = TriangleMesh(self._scene, self._vertices, self._faces)
        self._threads = threads
        # the first query commits the scene; do it before threads share it
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), query="OCCLUDED")

    @property
    def radius(self) -> float:
        return self._radius

    def closest_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> Hits:
        count = len(origins)
        face, t = np.empty(count, np.int32), np.empty(count, np.float32)
        bary = np.empty((count, 3), np.float32)

        def trace(part: slice) -> None:
            o, d, far, scale = self._prepare(origins[part], directions[part], _part_of(t_max, part))
            result = self._scene.run(o, d, dists=far, output=True)
            hit = result["primID"] != MISS
            face[part] = result["primID"]
            t[part] = np.where(hit, result["tfar"] * scale, np.float32(np.inf))
            corner = bary[part]
            corner[:, 1], corner[:, 2] = result["u"], result["v"]
            corner[:, 0] = 1 - corner[:, 1] - corner[:, 2]
            corner[~hit] = 0

        self._over_threads(trace, count)
        return Hits(face, t, bary)

    def any_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> np.ndarray:
        blocked = np.empty(len(origins), bool)

        def trace(part: slice) -> None:
            o, d, far, _ = self._prepare(origins[part], directions[part], _part_of(t_max, part))
            np.not_equal(self._scene.run(o, d, dists=far, query="OCCLUDED"), MISS, out=blocked[part])

        self._over_threads(trace, len(origins))
        return blocked

    def _prepare(
        self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.float32 | np.ndarray]:
        """embree's rays, and the factor that turns its t back into units of the directions' length."""
        squared = np.einsum("ij,ij->i", directions, directions)
        scale: np.float32 | np.ndarray = np.float32(self._radius)
        unit = directions
        # embree's tolerances want directions of about unit length
        if len(squared) and not (squared.min() > 0.25 and squared.max() < 4):
            length = np.sqrt(squared)
            unit, scale = directions / length[:, None], (self._radius / length).astype(np.float32)
        # by columns: numpy broadcasts [N, 3] against [3] in steps of 3, at three times the cost
        o = np.empty(origins.shape, np.float32)
        for axis in range(3):
            np.multiply(origins[:, axis] - self._centre[axis], 1 / self._radius, out=o[:, axis], casting="same_kind")
        far = np.empty(len(origins), np.float32)
        with np.errstate(over="ignore"):
            far[:] = np.minimum(np.asarray(t_max, np.float32) / scale, _FAR)
        return o, np.ascontiguousarray(unit, np.float32), far, scale

    def _over_threads(self, trace: Callable[[slice], None], count: int) -> None:
        """Call `trace` for slices of all rays: small enough to even out the threads, large enough to hide the calls."""
        from exmesh_graph.gpu.cores import workers

        threads = self._threads or workers()
        size = min(max(-(-count // (4 * threads)), _LEAST), _MOST)
        parts = [slice(start, min(start + size, count)) for start in range(0, count, size)]
        if len(parts) < 2 or threads == 1:
            for part in parts:
                trace(part)
            return
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(trace, parts))


def _part_of(t_max: float | np.ndarray, part: slice) -> float | np.ndarray:
    return t_max[part] if isinstance(t_max, np.ndarray) and t_max.ndim else t_max
