"""Light of small suns at surface samples: exact directions, one ray each, diffuse and specular."""

from __future__ import annotations

import math

import torch

from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.shading import brdf
from exmesh_graph.shading.suns import Suns, stratified, unoccluded
from exmesh_graph.stage2.surface import SurfaceSamples

#: A lobe narrower than this many radii of a sun samples the sun better than the sun's directions sample the lobe.
NARROW = 1.0


def narrow_lobes(suns: Suns, roughness: torch.Tensor) -> torch.Tensor:
    """Points [N] whose specular lobe is to meet the suns in its own samples (`traced_specular`), bool [N]."""
    return brdf.alpha_of(roughness) < NARROW * float(suns.radius.max()) if len(suns) else roughness < -math.inf


@torch.no_grad()
def sun_radiance(
    suns: Suns,
    flux: torch.Tensor,
    surface: SurfaceSamples,
    diffuse: torch.Tensor,
    roughness: torch.Tensor,
    f0: torch.Tensor,
    tracer: RayTracer,
    samples: int,
    generator: torch.Generator,
    chunk: int = 1 << 16,
) -> torch.Tensor:
    """Radiance [N, 3] that `surface` sends to its viewer of the suns' light, `flux` [S, 3].

    diffuse f_d [N, 3], roughness [N], f0 [N, 3]. Points with narrow lobes reflect it diffusely only. Directions are a
    set of `samples` per sun, shifted at random per point (Cranley and Patterson).
    """
    grid = stratified(samples).to(roughness.device)
    shift = torch.rand(len(surface), 3, generator=generator).to(roughness)
    origins = offset_origins(surface.position, surface.flat.double(), tracer.radius)
    mirrored = ~narrow_lobes(suns, roughness)
    result = torch.zeros_like(diffuse)
    for start in range(0, len(surface), chunk):
        part = slice(start, start + chunk)
        normal, view, f_d = surface.normal[part], surface.view[part], diffuse[part]
        for number in range(samples):
            towards = suns.directions((grid[number] + shift[part]) % 1)
            seen = unoccluded(origins[part], surface.flat[part], towards, tracer)
            cosine = (towards * normal).sum(-1).clamp_min(0) * seen
            f = f_d + brdf.specular(normal, view, towards, roughness[part], f0[part]) * mirrored[part, None]
            result[part] += (f * cosine[..., None] * flux[:, None]).sum(0)
    return result / samples
