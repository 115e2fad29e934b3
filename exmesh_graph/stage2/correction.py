"""What the split sum leaves out, measured with rays a few times during the fit and kept as a factor per pixel.

The specular term of a step is split_sum(theta) * c. `c` starts as the share of the lobe that sees the sky (from the K
rays of the light transport). Now and then it becomes traced(theta_now) / split_sum(theta_now): then the forward model
equals the traced one at theta_now (stretched lobes, true visibility, the mesh mirrored in itself) while gradients still
come from the cheap term. As the fit settles, so does `c`: a defect correction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from exmesh_graph.rays import RayTracer
from exmesh_graph.shading import brdf
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.sampling import Pyramid
from exmesh_graph.shading.specular import mean_visibility
from exmesh_graph.stage2.reflect import traced_specular

if TYPE_CHECKING:
    from exmesh_graph.stage2.fit import Light, Model

#: Bounds of the factor: where the split sum is nearly black the ratio means nothing.
LARGEST = 4.0


@torch.no_grad()
def initial_specular_scale(model: Model, chunk: int = 1 << 14) -> None:
    """Set every view's factor to the visible share of its lobe at the starting roughness."""
    visible = model.operators.visible.float()
    directions = torch.from_numpy(model.operators.light.directions).to(visible)
    for buffer in model.buffers:
        reflected = buffer.samples(model.geometry).reflected
        for start in range(0, len(buffer.pixel), chunk):
            part = slice(start, start + chunk)
            seen = (visible[buffer.point[part]] * buffer.point_weight[part, :, None]).sum(1)
            share = mean_visibility(seen, directions, reflected[part], model.settings.roughness_start)
            buffer.specular_scale[part] = share[:, None]


@torch.no_grad()
def measure_specular_scale(model: Model, tracer: RayTracer, indirect: float, generator: torch.Generator) -> None:
    """Set every view's factor to traced / split sum under the current materials and light."""
    maps = model.maps()
    light = model.light(maps, indirect)
    pyramid = Pyramid(light.environment)
    metallic = model.settings.metallic
    for buffer in model.buffers:
        if len(buffer.pixel) == 0:
            continue
        material = gather_rows(maps, buffer.texel, buffer.texel_weight)
        f0 = brdf.base_reflectance(material[:, :3], material[:, 4] if metallic else None)
        traced = traced_specular(
            buffer.samples(model.geometry),
            model.geometry.face_normals,
            material[:, 3],
            f0,
            pyramid,
            tracer,
            _hit_radiance(model, maps, light),
            model.settings.correction_samples,
            generator,
        )
        split = model.split_sum(buffer, material, light)
        buffer.specular_scale = (traced / split.clamp_min(1e-6)).clamp(0, LARGEST)


def _hit_radiance(model: Model, maps: torch.Tensor, light: Light):  # type: ignore[no-untyped-def]
    """Diffuse radiance of hits, read at the lattice points around them (a reflection blurs more than that)."""
    transport = model.operators.light
    material = gather_rows(maps, model.point_texel, model.point_weight)
    f_d = brdf.diffuse(material[:, :3], material[:, 4] if model.settings.metallic else None)
    leaving = f_d * light.irradiance
    return lattice_radiance(transport, leaving)


def lattice_radiance(transport, leaving: torch.Tensor):  # type: ignore[no-untyped-def]
    """A HitRadiance that interpolates `leaving` [P, 3] over the lattice of `transport`."""
    from exmesh_graph.shading.lattice import locate

    def radiance(face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        index, weight = locate(transport.face_points, transport.subdivision, face.cpu().numpy(), bary.cpu().numpy())
        rows = torch.from_numpy(index.astype("int64")).to(leaving.device)
        return gather_rows(leaving, rows, torch.from_numpy(weight).to(leaving))

    return radiance
