"""What every ray tracer of the project can do, and where a ray starts.

A tracer is built once for a frozen mesh. Implementations: `embree.EmbreeTracer` (CPU), `brute.BruteTracer`
(all pairs, the reference of the tests). A CUDA tracer over Warp's BVH plugs in behind the same protocol.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

MISS = -1

#: Distance by which a ray's origin is lifted off its surface, as a part of the scene's radius. float32 ray
#: tracing resolves about 1e-7 of the radius; embree's intersections are good to a few units of that.
RELATIVE_OFFSET = 2e-5


@dataclass(frozen=True)
class Hits:
    """Nearest intersections of N rays.

    face  int32 [N], -1 where nothing was hit
    t     float32 [N], distance in units of the length of the ray's direction; inf where nothing was hit
    bary  float32 [N, 3], weights of the face's corners; 0 where nothing was hit
    """

    face: np.ndarray
    t: np.ndarray
    bary: np.ndarray


class RayTracer(Protocol):
    """Nearest and any intersection with a frozen triangle mesh; both sides of a face stop a ray."""

    @property
    def radius(self) -> float:
        """Half the diagonal of the mesh's bounding box, in world units."""

    def closest_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> Hits:
        """Nearest hit with 0 < t < t_max of rays `origins` + t `directions`, both [N, 3]."""

    def any_hit(self, origins: np.ndarray, directions: np.ndarray, t_max: float | np.ndarray = np.inf) -> np.ndarray:
        """bool [N]: whether anything lies on the ray with 0 < t < t_max."""


def offset_origins(points: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Lift ray origins off the surface they lie on, along the unit *geometric* normal.

    The lift is `RELATIVE_OFFSET` of the scene's radius plus a few float32 steps of the coordinate itself, so it
    follows the scene's scale and its distance from the world's origin; there is no absolute length in it.

    points [N, 3]; normals [N, 3], on the side the rays leave to; radius as `RayTracer.radius`.
    """
    rounding = 8 * np.finfo(np.float32).eps * np.abs(points).max(axis=1, keepdims=True)
    return points + normals * (RELATIVE_OFFSET * radius + rounding)


def make_ray_tracer(vertices: np.ndarray, faces: np.ndarray, device: str = "cpu") -> RayTracer:
    """The tracer for `device`: embree for "cpu".

    vertices [V, 3], faces [F, 3]. Raises MissingLibraryError when embreex is not installed, and GeometryError for
    an empty mesh or vertices that are not finite.
    """
    from exmesh_graph.rays.embree import EmbreeTracer

    if device != "cpu":
        raise NotImplementedError(f"no ray tracer for device {device!r} yet; trace on 'cpu'")
    return EmbreeTracer(vertices, faces)
