"""Rays towards small suns on a CPU: aimed in one pass of explicit vectors, and reflected in one pass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.simd import LANES
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.rays.tensors import any_hit
from exmesh_graph.shading.point_sets import sobol_points
from exmesh_graph.shading.suns import Suns
from exmesh_graph.stage2.light.traced import NARROW, SunRays
from exmesh_graph.stage2.surface import SurfaceSamples

#: Groups of 8 points of an item.
GROUPS = 64


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.stage2.light import kernels_suns

    return kernels_suns


def trace_suns(
    suns: Suns, surface: SurfaceSamples, tracer: RayTracer, samples: int, shift: torch.Tensor
) -> SunRays | FusedSunRays:
    """As `SunRays.traced`, of explicit vectors where the surface is float32 on the CPU."""
    if len(suns) and surface.position.device.type == "cpu" and surface.position.dtype == torch.float32:
        return FusedSunRays.traced(suns, surface, tracer, samples, shift)
    return SunRays.traced(suns, surface, tracer, samples, shift)


@dataclass(frozen=True)
class FusedSunRays:
    """Rays (traced.SunRays) of points in groups of 8: ray ((g samples + s) S + k) 8 + j goes from point 8 g + j to sun
    k; direction float32 [rays, 3], seen float32 [rays]: the cosine, 0 where the sun is hidden."""

    suns: Suns
    surface: SurfaceSamples
    samples: int
    direction: torch.Tensor
    seen: torch.Tensor

    @classmethod
    @torch.no_grad()
    def traced(
        cls, suns: Suns, surface: SurfaceSamples, tracer: RayTracer, samples: int, shift: torch.Tensor
    ) -> FusedSunRays:
        """As `SunRays.traced`; one sun at least, float32 on the CPU."""
        count, number = len(surface), len(suns)
        groups = -(-count // LANES)
        total = groups * samples * number * LANES
        direction, seen = torch.empty(total, 3), torch.empty(total)
        own = [suns.sun == k for k in range(number)]
        first = torch.tensor([0, *(int(mine.sum()) for mine in own)], dtype=torch.int32).cumsum(0, dtype=torch.int32)
        texel = torch.cat([suns.texel[mine] for mine in own]).int()
        cumulated = torch.cat([suns.share[mine].cumsum(0) for mine in own]).float()
        split(
            _kernels().aim, -(-groups // GROUPS), GROUPS, count, samples, *suns.shape, first, texel, cumulated,
            sobol_points(samples).float(), shift.float().contiguous(), surface.normal.contiguous(),
            surface.flat.contiguous(), direction, seen, grain=1,
        )  # fmt: skip
        lit = torch.nonzero(seen)[:, 0]
        point = torch.div(lit, samples * number * LANES, rounding_mode="floor") * LANES + lit % LANES
        origins = offset_origins(surface.position, surface.flat.double(), tracer.radius)
        hidden = any_hit(tracer, origins.index_select(0, point), direction.index_select(0, lit))
        seen[lit[hidden]] = 0
        return cls(suns, surface, samples, direction, seen)

    @torch.no_grad()
    def radiance(
        self, flux: torch.Tensor, diffuse: torch.Tensor, roughness: torch.Tensor, f0: torch.Tensor
    ) -> torch.Tensor:
        """As `SunRays.radiance`."""
        count = len(roughness)
        least = NARROW * float(self.suns.radius.max())
        result = torch.empty(count, 3)
        items = -(-count // (LANES * GROUPS))
        split(
            _kernels().reflect, items, GROUPS, count, self.samples, least, self.surface.normal.contiguous(),
            self.surface.view.contiguous(), self.direction, self.seen, flux.contiguous(), diffuse.contiguous(),
            roughness.contiguous(), f0.contiguous(), result, grain=1,
        )  # fmt: skip
        return result
