"""Specular light by rays: GGX samples against the mesh, with the mesh's own light where a ray meets it."""

from __future__ import annotations

from collections.abc import Callable

import torch

from exmesh_graph.rays import MISS, RayTracer, offset_origins, tensors
from exmesh_graph.shading.brdf import alpha_of, schlick
from exmesh_graph.shading.sampling import Pyramid, hammersley, sample_specular
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
            surface.normal[part], surface.view[part], alpha_of(roughness[part]), (grid + shift[part]) % 1
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
        fresnel = schlick(v_h[row, column], f0[part][row])
        value = radiance * fresnel * weight[row, column][:, None]
        result[part] = torch.zeros(shape[0], 3, device=roughness.device).index_add_(0, row, value) / samples
    return result
