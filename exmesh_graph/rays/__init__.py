"""Ray tracing against a frozen mesh: embree on the CPU, Warp's BVH on CUDA, torch tensors by `tensors`."""

from exmesh_graph.rays.tracer import MISS, Hits, RayTracer, make_ray_tracer, offset_origins

__all__ = ["MISS", "Hits", "RayTracer", "make_ray_tracer", "offset_origins"]
