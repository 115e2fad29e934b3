"""What the split sum leaves out, measured with rays a few times during the fit and kept as a factor per pixel.

The specular term of a step is split_sum(theta) * c. `c` starts as the share of the lobe that sees the sky (from the K
rays of the light transport). Now and then it becomes traced(theta_now) / split_sum(theta_now): then the forward model
equals the traced one at theta_now (stretched lobes, true visibility, the mesh mirrored in itself) while gradients still
come from the cheap term. As the fit settles, so does `c`: a defect correction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from exmesh_graph.shading import brdf
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.lattice import locate
from exmesh_graph.shading.sampling import Pyramid
from exmesh_graph.shading.specular import mean_visibility
from exmesh_graph.stage2.reflect import HitRadiance, traced_specular
from exmesh_graph.types import Transport

if TYPE_CHECKING:
    from exmesh_graph.stage2.gbuffer import ViewBuffer
    from exmesh_graph.stage2.maps import Material
    from exmesh_graph.stage2.precomputed import PrecomputedLight, PrecomputedLit

#: Bounds of the factor: where the split sum is nearly black the ratio means nothing.
LARGEST = 4.0


@torch.no_grad()
def initial_specular_scale(
    light: PrecomputedLight, buffer: ViewBuffer, roughness: float, chunk: int = 1 << 14
) -> torch.Tensor:
    """A view's factor [N, 3] before any measurement: the visible share of the lobe of `roughness`."""
    visible = light.operators.visible.float()
    directions = torch.from_numpy(light.operators.light.directions).to(visible)
    kept, reflected = buffer.light, buffer.samples(light.geometry).reflected
    scale = torch.ones_like(kept.specular_scale)
    for start in range(0, len(buffer.pixel), chunk):
        part = slice(start, start + chunk)
        seen = (visible[kept.point[part]] * kept.point_weight[part, :, None]).sum(1)
        share = mean_visibility(seen, directions, reflected[part], roughness)
        scale[part] = share[:, None]
    return scale


@torch.no_grad()
def measured_specular_scale(
    light: PrecomputedLight,
    buffer: ViewBuffer,
    material: Material,
    lit: PrecomputedLit,
    environment: torch.Tensor,
    leaving: torch.Tensor,
    generator: torch.Generator,
) -> torch.Tensor:
    """A view's factor [N, 3], traced / split sum; `leaving` [P, 3] is the diffuse radiance of the lattice points."""
    surface = light.surface(buffer, material)
    traced = traced_specular(
        surface,
        light.geometry.face_normals,
        material.roughness,
        brdf.base_reflectance(material.base_color, material.metallic),
        Pyramid(environment),
        light.tracer,
        lattice_radiance(light.operators.light, leaving),
        light.settings.correction_samples,
        torch.rand(len(surface), 2, generator=generator),
    )
    split = light.split_sum(buffer, material, lit, None if light.frames is None else surface)
    return (traced / split.clamp_min(1e-6)).clamp(0, LARGEST)


def lattice_radiance(transport: Transport, leaving: torch.Tensor) -> HitRadiance:
    """A HitRadiance that interpolates `leaving` [P, 3] over the lattice of `transport` (a reflection blurs more)."""

    def radiance(face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        index, weight = locate(transport.face_points, transport.subdivision, face.cpu().numpy(), bary.cpu().numpy())
        rows = torch.from_numpy(index.astype("int64")).to(leaving.device)
        return gather_rows(leaving, rows, torch.from_numpy(weight).to(leaving))

    return radiance
