"""Light of surface samples by rays of their own: the specular lobe against the mesh, and small suns.

The lobe is sampled by GGX, with the mesh's own light where a ray meets it; a sun by exact directions, one ray each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.rays import MISS, RayTracer, offset_origins, tensors
from exmesh_graph.shading import brdf
from exmesh_graph.shading.brdf_sampling import sample_specular
from exmesh_graph.shading.envmap import Pyramid
from exmesh_graph.shading.operators import LightTransport
from exmesh_graph.shading.point_sets import hammersley, sobol_points
from exmesh_graph.shading.suns import Suns, find_suns, sun_transfer, unoccluded
from exmesh_graph.shading.transport import lattice_origins
from exmesh_graph.stage2.gbuffer import ViewBuffer
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
    chunk: int = 1 << 15,
    extra: tuple[Pyramid, torch.Tensor] | None = None,
) -> torch.Tensor:
    """Specular radiance [N, 3]: the mean over `samples` visible-normal samples of F G/G1 times what their ray meets.

    Free rays read the environment averaged over the solid angle they stand for (Krivanek and Colbert 2008); rays that
    meet a front face (by `face_normals` [F, 3]) read its diffuse radiance; back faces are black.
    roughness [N], f0 [N, 3]. `extra`: light that only the samples of some points (bool [N]) meet.
    The samples are one Hammersley set, moved by `shift` [N, 2], uniform in [0, 1), per point (Cranley and Patterson).
    """
    grid = hammersley(samples, roughness.device)
    shift = shift[:, None].to(roughness)
    result = torch.empty(len(surface), 3, device=roughness.device)
    for start in range(0, len(surface), chunk):
        part = slice(start, start + chunk)
        light, weight, pdf, v_h = sample_specular(
            surface.normal[part], surface.view[part], brdf.alpha_of(roughness[part]), (grid + shift[part]) % 1
        )
        shape = weight.shape
        flat_normal = surface.flat[part]
        useful = (weight > 0) & ((light * flat_normal[:, None]).sum(-1) > 0)
        row, column = torch.nonzero(useful, as_tuple=True)
        directions = light[row, column]
        origins = offset_origins(surface.position[part], flat_normal.double(), tracer.radius)
        hits = tensors.closest_hit(tracer, origins[row], directions)
        face = hits.face.long()
        radiance = torch.zeros(len(row), 3, device=roughness.device)
        free = face == MISS
        solid_angle = 1 / (samples * pdf[row, column][free])
        radiance[free] = pyramid.lookup(directions[free], solid_angle)
        if extra is not None:
            meets = extra[1][part][row][free]
            radiance[torch.nonzero(free)[meets, 0]] += extra[0].lookup(directions[free][meets], solid_angle[meets])
        if not bool(free.all()):
            front = ~free & ((face_normals[face.clamp_min(0)] * directions).sum(-1) < 0)
            radiance[front] = hit_radiance(face[front], hits.bary[front])
        fresnel = brdf.schlick(v_h[row, column], f0[part][row])
        value = radiance * fresnel * weight[row, column][:, None]
        result[part] = torch.zeros(shape[0], 3, device=roughness.device).index_add_(0, row, value) / samples
    return result


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
    grid = sobol_points(samples).to(roughness.device)
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
