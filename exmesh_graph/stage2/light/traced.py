"""Light of surface samples by rays of their own: the specular lobe against the mesh, and small suns.

The lobe is sampled by GGX, with the mesh's own light where a ray meets it; a sun by exact directions, one ray each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.shading import brdf
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.point_sets import sobol_points
from exmesh_graph.shading.suns import Suns, unoccluded
from exmesh_graph.stage2.light.fused_lobes import trace_lobes
from exmesh_graph.stage2.light.lobes import Sky
from exmesh_graph.stage2.surface import SurfaceSamples

#: (face int64 [N], bary [N, 3]) -> diffuse radiance [N, 3] that the surface sends out there.
HitRadiance = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


@torch.no_grad()
def traced_specular(
    surface: SurfaceSamples,
    face_normals: torch.Tensor,
    roughness: torch.Tensor,
    f0: torch.Tensor,
    pyramid: Pyramid,
    tracer: RayTracer,
    hit_radiance: HitRadiance,
    samples: int,
    shift: torch.Tensor,
    shared: float = 1.0,
    chunk: int = 1 << 13,
) -> torch.Tensor:
    """Specular radiance [N, 3] of `samples` rays per point (`fused_lobes.trace_lobes`); the mesh sends `hit_radiance`,
    the sky `pyramid`. face_normals [F, 3], roughness [N], f0 [N, 3], shift [N, 2]; `shared`: lobes.Lobes.radiance."""
    sky = Sky(pyramid)
    result = torch.empty_like(f0)
    for start in range(0, len(surface), chunk):
        part = slice(start, start + chunk)
        lobes = trace_lobes(surface[part], face_normals, roughness[part], tracer, samples, shift[part])
        result[part] = lobes.radiance(f0[part], sky, hit_radiance(lobes.face, lobes.bary), shared=shared)
    return result


#: A lobe narrower than this many radii of a sun samples the sun better than the sun's directions sample the lobe.
NARROW = 1.0


def narrow_lobes(suns: Suns, roughness: torch.Tensor) -> torch.Tensor:
    """Points [N] whose specular lobe is to meet the suns in its own samples (`traced_specular`), bool [N]."""
    return brdf.alpha_of(roughness) < NARROW * float(suns.radius.max()) if len(suns) else roughness < -math.inf


@dataclass(frozen=True)
class SunRays:
    """Rays from N surface samples towards S small suns: for each sample `towards` [S, N, 3] and `cosine` [S, N] of
    what is seen of a sun (0 where it is hidden)."""

    suns: Suns
    surface: SurfaceSamples
    towards: list[torch.Tensor]
    cosine: list[torch.Tensor]

    @classmethod
    @torch.no_grad()
    def traced(
        cls, suns: Suns, surface: SurfaceSamples, tracer: RayTracer, samples: int, shift: torch.Tensor
    ) -> SunRays:
        """A set of `samples` directions per sun, moved by `shift` [N, 3], uniform in [0, 1), per point (Cranley and
        Patterson)."""
        grid = sobol_points(samples).to(surface.n_v.device)
        origins = offset_origins(surface.position, surface.flat.double(), tracer.radius)
        towards = [suns.directions((grid[number] + shift.to(surface.n_v)) % 1) for number in range(samples)]
        cosine = [
            (each * surface.normal).sum(-1).clamp_min(0) * unoccluded(origins, surface.flat, each, tracer)
            for each in towards
        ]
        return cls(suns, surface, towards, cosine)

    @torch.no_grad()
    def radiance(
        self, flux: torch.Tensor, diffuse: torch.Tensor, roughness: torch.Tensor, f0: torch.Tensor
    ) -> torch.Tensor:
        """Radiance [N, 3] that the samples send to their viewer of the suns' light, `flux` [S, 3].

        diffuse f_d [N, 3], roughness [N], f0 [N, 3]. Points with narrow lobes reflect it diffusely only.
        """
        normal, view = self.surface.normal, self.surface.view
        mirrored = ~narrow_lobes(self.suns, roughness)[:, None]
        result = torch.zeros_like(diffuse)
        for towards, cosine in zip(self.towards, self.cosine, strict=True):
            f = diffuse + brdf.specular(normal, view, towards, roughness, f0) * mirrored
            result += (f * cosine[..., None] * flux[:, None]).sum(0)
        return result / len(self.towards)
