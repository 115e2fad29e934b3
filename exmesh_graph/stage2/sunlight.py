"""Light of small suns at surface samples: exact directions, one ray each, diffuse and specular."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import RayTracer, offset_origins
from exmesh_graph.shading import brdf
from exmesh_graph.shading.suns import Suns, find_suns, stratified, sun_transfer, unoccluded
from exmesh_graph.shading.transport import LightTransport, lattice_origins
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples

if TYPE_CHECKING:
    from exmesh_graph.stage2.gbuffer import ViewBuffer

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
    shift: torch.Tensor,
    chunk: int = 1 << 16,
) -> torch.Tensor:
    """Radiance [N, 3] that `surface` sends to its viewer of the suns' light, `flux` [S, 3].

    diffuse f_d [N, 3], roughness [N], f0 [N, 3]. Points with narrow lobes reflect it diffusely only. Directions are a
    set of `samples` per sun, moved by `shift` [N, 3], uniform in [0, 1), per point (Cranley and Patterson).
    """
    grid = stratified(samples).to(roughness.device)
    shift = shift.to(roughness)
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
    views = {}
    for buffer in buffers:
        surface = buffer.samples(geometry)
        start = offset_origins(surface.position, surface.flat.double(), tracer.radius)
        views[buffer.number] = sun_transfer(suns, start, surface.normal, surface.flat, tracer)
    return FittedSuns(suns, lattice, views, operators.with_columns(lattice))
