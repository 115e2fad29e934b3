"""Ray tracing against a frozen mesh: embree on the CPU, Warp's BVH on CUDA, torch tensors by `tensors`."""

from __future__ import annotations

import numpy as np

from exmesh_graph.rays.tracer import MISS, Hits, RayTracer, offset_origins

__all__ = ["MISS", "Hits", "RayTracer", "make_ray_tracer", "offset_origins"]


def make_ray_tracer(
    vertices: np.ndarray, faces: np.ndarray, device: str = "cpu", threads: int | None = None
) -> RayTracer:
    """The tracer for `device`: embree on `threads` cores (None: all) for "cpu", Warp's BVH for "cuda".

    vertices [V, 3], faces [F, 3]. Raises MissingLibraryError when embreex is not installed or torch sees no CUDA
    device, and GeometryError for an empty mesh or vertices that are not finite.
    """
    if device == "cpu":
        from exmesh_graph.rays.embree import EmbreeTracer

        return EmbreeTracer(vertices, faces, threads)
    from exmesh_graph.gpu.torch_setup import pick_device
    from exmesh_graph.rays.warp_bvh import WarpTracer

    pick_device(device.split(":")[0])
    return WarpTracer(vertices, faces, device)
