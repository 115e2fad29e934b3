"""Light of surface samples by rays of their own: the specular lobe against the mesh, and small suns.

The lobe is sampled by GGX, with the mesh's own light where a ray meets it; a sun by exact directions, one ray each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.shading import brdf
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.operators import LightTransport
from exmesh_graph.shading.point_sets import sobol_points
from exmesh_graph.shading.suns import Suns, find_suns, sun_transfer, unoccluded
from exmesh_graph.shading.transport import lattice_origins
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.fused_lobes import trace_lobes
from exmesh_graph.stage2.light.lobes import Sky
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples

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


@dataclass(frozen=True)
class FittedSuns:
    """The suns of a fit's environment as it was last measured, and where their light goes.

    lattice    [P, S], irradiance of lattice points per flux (shading.suns.sun_transfer);  views  the same of a view's
               pixels, [N, S] by the view's number;  operators  the transport with the suns as further directions
    """

    suns: Suns
    lattice: torch.Tensor
    views: Mapping[int, torch.Tensor]
    operators: LightTransport

    def under(self, operators: LightTransport) -> FittedSuns:
        """The same with another transport of the same mesh."""
        return replace(self, operators=operators.with_columns(self.lattice))

    def state(self) -> dict[str, Any]:
        return {"suns": dict(vars(self.suns)), "lattice": self.lattice, "views": dict(self.views)}

    @classmethod
    def restored(cls, kept: Mapping[str, Any], operators: LightTransport) -> FittedSuns:
        device = operators.transfer.device
        told: dict[str, Any] = {
            name: value.to(device) if isinstance(value, torch.Tensor) else tuple(value)
            for name, value in kept["suns"].items()
        }
        lattice = kept["lattice"].to(device)
        views = {number: transfer.to(device) for number, transfer in kept["views"].items()}
        return cls(Suns(**told), lattice, views, operators.with_columns(lattice))


@torch.no_grad()
def find_fitted_suns(
    environment: torch.Tensor,
    operators: LightTransport,
    geometry: CarrierGeometry,
    tracer: RayTracer,
    buffers: Iterable[ViewBuffer],
) -> FittedSuns | None:
    """The suns of `environment`, traced from the lattice and all views' pixels; None where there are none."""
    light, device = operators.light, geometry.device
    suns = find_suns(environment, len(light.directions))
    if not len(suns):
        return None
    vertices, faces = geometry.vertices.cpu().numpy(), geometry.faces.cpu().numpy()
    origins = tensor_of(lattice_origins(light, vertices, faces, tracer.radius)).to(device)
    flat = geometry.face_normals[torch.from_numpy(light.point_face.astype("int64")).to(device)]
    lattice = sun_transfer(suns, origins, tensor_of(light.normals).to(device), flat, tracer)

    @torch.no_grad()  # a thread's own switch
    def traced(buffer: ViewBuffer) -> tuple[int, torch.Tensor]:
        surface = buffer.samples(geometry)
        start = offset_origins(surface.position, surface.flat.double(), tracer.radius)
        return buffer.number, sun_transfer(suns, start, surface.normal, surface.flat, tracer)

    return FittedSuns(suns, lattice, dict(share(traced, buffers)), operators.with_columns(lattice))
