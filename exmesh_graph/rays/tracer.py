"""What every ray tracer of the project can do, and where a ray starts.

A tracer is built once for a frozen mesh. Implementations: `embree.EmbreeTracer` (CPU) and `warp_bvh.WarpTracer` (CUDA).
`tensors` runs either of them on torch tensors; `benchmarks.brute_rays`, all pairs, is what the tests compare them with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array", np.ndarray, "torch.Tensor")

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


def offset_origins(points: Array, normals: Array, radius: float) -> Array:
    """Lift ray origins off the surface they lie on, along the unit *geometric* normal: float64 [N, 3].

    The lift is `RELATIVE_OFFSET` of the scene's radius, for the tracer's rounding, plus 8 steps of the point's largest
    coordinate in the precision it comes in, for the point's own. So it follows the scene's scale, and its distance
    from the world's origin as far as the points have lost digits to it; there is no absolute length in it. Waechter
    and Binder (Ray Tracing Gems, ch. 6) move each coordinate by 256 of its float32 steps and, near zero, by 1/65536
    of the unit; on the tracers' mesh (centred, unit radius) that is 1.5e-5 to 3e-5, the same lift with jumps in it.

    points, normals [N, 3]: both arrays or both tensors; hand over points as they were computed, in float32 if in
    float32. Normals on the side the rays leave to; radius as `RayTracer.radius`.
    """
    if isinstance(points, np.ndarray):
        rounding = 8 * float(np.finfo(points.dtype).eps)
        exact = points.astype(np.float64, copy=False)
        return exact + normals * (RELATIVE_OFFSET * radius + rounding * np.abs(exact).max(axis=1, keepdims=True))
    rounding = 8 * float(np.finfo(str(points.dtype).removeprefix("torch.")).eps)
    wide = points.double()
    return wide + normals * (RELATIVE_OFFSET * radius + rounding * wide.abs().amax(dim=1, keepdim=True))
