"""Specular lobes on a CPU: rays made in one pass of explicit vectors, and lit in one pass."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.simd import LANES
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.rays import RayTracer, offset_origins, tensors
from exmesh_graph.shading.point_sets import hammersley
from exmesh_graph.stage2.light.lobes import Lobes, PlainLobes, Sky
from exmesh_graph.stage2.surface import SurfaceSamples

#: Groups of 8 points of an item.
GROUPS = 64
#: Pixels of an item of `visible_share`.
PIXELS = 512


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.stage2.light import kernels_lobes

    return kernels_lobes


def trace_lobes(
    surface: SurfaceSamples,
    face_normals: torch.Tensor,
    roughness: torch.Tensor,
    tracer: RayTracer,
    samples: int,
    shift: torch.Tensor,
) -> Lobes:
    """Trace `samples` visible-normal samples of the lobe of each point.

    face_normals [F, 3], roughness [N]. The samples are one Hammersley set, moved by `shift` [N, 2], uniform in [0, 1),
    per point (Cranley and Patterson).
    """
    if roughness.device.type == "cpu" and roughness.dtype == surface.position.dtype == torch.float32:
        return FusedLobes.traced(surface, face_normals, roughness, tracer, samples, shift)
    return PlainLobes.traced(surface, face_normals, roughness, tracer, samples, shift)


@dataclass(frozen=True)
class FusedLobes:
    """Lobes (stage2.light.lobes) of `count` points, in groups of 8: ray (g S + s) 8 + j is sample s of point 8 g + j.

    rays  float32 [groups, S, 5, 8]: G / G1 (0: no use), (1 - v.h)^5, u, v, half the log2 of the solid angle
    slot  int32 [groups S 8]: what the ray met, the sky (-1), nothing that shines (-2), else the number of a front face
    """

    face: torch.Tensor
    bary: torch.Tensor
    count: int
    samples: int
    rays: torch.Tensor
    slot: torch.Tensor

    @classmethod
    @torch.no_grad()
    def traced(
        cls,
        surface: SurfaceSamples,
        face_normals: torch.Tensor,
        roughness: torch.Tensor,
        tracer: RayTracer,
        samples: int,
        shift: torch.Tensor,
    ) -> FusedLobes:
        """As `trace_lobes`; float32 on the CPU."""
        count = len(roughness)
        groups = -(-count // LANES)
        total = groups * samples * LANES
        direction, reach = torch.empty(total, 3), torch.empty(total)
        rays = torch.empty(groups, samples, 5, LANES)
        items = -(-groups // GROUPS)
        split(
            _kernels().make_rays, items, GROUPS, count, samples, hammersley(samples), shift.float().contiguous(),
            surface.normal.contiguous(), surface.view.contiguous(), surface.flat.contiguous(), roughness.contiguous(),
            direction, reach, rays, grain=1,
        )  # fmt: skip
        origins = offset_origins(surface.position, surface.flat.double(), tracer.radius)
        point = torch.arange(groups * LANES).clamp_max(max(count - 1, 0)).reshape(groups, 1, LANES)
        point = point.expand(-1, samples, -1).reshape(-1)
        hits = tensors.closest_hit(tracer, origins.index_select(0, point), direction, reach)
        slot = torch.full((total,), -1, dtype=torch.int32)
        hit = torch.nonzero(hits.face >= 0)[:, 0]
        face = hits.face[hit].long()
        front = (face_normals[face] * direction[hit]).sum(-1) < 0
        slot[hit] = -2
        face, hit = face[front], hit[front]
        slot[hit] = torch.arange(len(hit), dtype=torch.int32)
        return cls(face, hits.bary[hit], count, samples, rays, slot)

    @torch.no_grad()
    def radiance(
        self, f0: torch.Tensor, sky: Sky, sent: torch.Tensor, extra: torch.Tensor | None = None, shared: float = 1.0
    ) -> torch.Tensor:
        """As `lobes.Lobes.radiance`."""
        texels, levels = sky.table
        more = extra if extra is not None and sky.extra is not None else torch.zeros(0, dtype=torch.bool)
        result = torch.empty(self.count, 3)
        items = -(-len(self.rays) // GROUPS)
        split(
            _kernels().light_rays, items, GROUPS, self.count, self.samples, 0.5 * math.log2(shared * sky.pyramid.texel),
            self.rays, self.slot, f0.contiguous(), torch.nn.functional.pad(sent, (0, 1)), more, texels, levels, result,
            grain=1,
        )  # fmt: skip
        return result


def visible_share(
    visible: torch.Tensor,
    directions: torch.Tensor,
    point: torch.Tensor,
    weight: torch.Tensor,
    reflected: torch.Tensor,
    alpha: float,
) -> torch.Tensor:
    """The share [N] of the lobe of width `alpha` around `reflected` [N, 3] that sees the sky.

    visible uint8 [P, K] of the lattice points towards `directions` [K, 3]; point int32 [N, 3] and weight [N, 3]: those
    around each pixel. Float32 on the CPU; else, and as the reference, shading.specular.mean_visibility.
    """
    result = torch.empty(len(reflected))
    items = -(-len(reflected) // PIXELS)
    split(
        _kernels().visible_share, items, PIXELS, len(reflected), len(directions), alpha, directions.t().contiguous(),
        visible, point, weight, reflected, result, grain=1,
    )  # fmt: skip
    return result
