"""Ray tracing against a frozen mesh: embree on the CPU, Warp's BVH on CUDA, torch tensors by `tensors`."""

from __future__ import annotations

import numpy as np

from exmesh_graph.rays.tracer import MISS, Hits, RayTracer, offset_origins

__all__ = ["MISS", "Hits", "RayTracer", "make_ray_tracer", "offset_origins"]


def make_ray_tracer(
    vertices: np.ndarray,
    faces: np.ndarray,
    device: str = "cpu",
    threads: int | None = None,
    casts: np.ndarray | None = None,
) -> RayTracer:
    """The tracer for `device`: embree on `threads` cores (None: `gpu.cores`') for "cpu", Warp's BVH for "cuda".

    vertices [V, 3], faces [F, 3]; `casts` bool [F], the faces that stop rays (None: all), which keep their numbers, and
    whose box alone is the tracer's. Raises MissingLibraryError when embreex is not installed or torch sees no CUDA
    device, and GeometryError for an empty mesh or vertices that are not finite.
    """
    if casts is not None and not casts.all():
        vertices, faces = _only(vertices, faces, casts)
    if device == "cpu":
        from exmesh_graph.rays.embree import EmbreeTracer

        return EmbreeTracer(vertices, faces, threads)
    from exmesh_graph.gpu.torch_setup import pick_device
    from exmesh_graph.rays.warp_bvh import WarpTracer

    pick_device(device.split(":")[0])
    return WarpTracer(vertices, faces, device)


def _only(vertices: np.ndarray, faces: np.ndarray, casts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with every other face shrunk to a point, which no ray meets."""
    used = np.zeros(len(vertices), bool)
    used[faces[casts]] = True
    place = vertices[np.argmax(used)]
    return np.where(used[:, None], vertices, place), np.where(casts[:, None], faces, faces[:, :1])
