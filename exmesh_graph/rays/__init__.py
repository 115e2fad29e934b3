"""Ray tracing against a frozen mesh: one small protocol, embree on the CPU."""

from exmesh_graph.rays.tracer import MISS, Hits, RayTracer, make_ray_tracer, offset_origins

__all__ = ["MISS", "Hits", "RayTracer", "make_ray_tracer", "offset_origins"]
