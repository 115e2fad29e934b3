"""The terms of a step under the precomputed light, by fused kernels: what the default fit on a CPU runs.

Maps are read where they are needed (fused.maps), a view's pixels are shaded and compared in one pass (fused.view); sky
and transport stay with autograd. Sampled light, normal maps, other devices and dtypes: `objective.plain_terms`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from exmesh_graph.shading import envmap
from exmesh_graph.shading.specular import scattered
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fused.maps import read_maps
from exmesh_graph.stage2.fused.view import SeenView, image_terms
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.precomputed import PrecomputedLight
from exmesh_graph.stage2.maps import Footprint


@dataclass(frozen=True)
class ViewTerms:
    """Unweighted terms of a view, its radiance [N, 3] (detached), and the sky [H, W, 3] for its own terms."""

    log_l1: torch.Tensor
    d_ssim: torch.Tensor
    variation: torch.Tensor
    predicted: torch.Tensor
    environment: torch.Tensor


def serves(model: Decomposition) -> bool:
    """Whether the fused kernels compute the model's terms."""
    parameter = model.maps.parameter
    plain = (
        parameter.device.type == "cpu" and parameter.dtype == torch.float32 and model.environment.dtype == torch.float32
    )
    return plain and isinstance(model.light, PrecomputedLight) and not model.settings.normal_map and model.maps.size > 1


def view_terms(model: Decomposition, buffer: ViewBuffer, strength: float) -> ViewTerms:
    """The terms of one view with lambda_ind = `strength`; differentiable in maps, sky and common factor."""
    light, settings = model.light, model.settings
    assert isinstance(light, PrecomputedLight)
    radiance = envmap.radiance_of(model.environment)
    gain = model.factor.parameter.exp()
    bounced = light.operators.bounces > 0 and strength > 0
    points = light.footprint(model.maps) if bounced else _NOWHERE
    material, sent = read_maps(model.maps, gain, buffer.footprint, points)
    diffuse = scattered(sent[:, :3], sent[:, 3], sent[:, 4] if settings.metallic else None) if bounced else None
    arriving = light.arriving(radiance * gain, diffuse, strength)
    flux, transfer = arriving.irradiance[:0], arriving.irradiance[:0]
    if light.suns is not None and arriving.flux is not None:
        flux, transfer = arriving.flux, light.suns.views[buffer.number]
    exposure = 1.0 if model.exposure is None else float(model.exposure.gain(buffer.number))
    seen = SeenView(buffer, light.lookup, transfer, exposure, settings.ssim_weight > 0, settings.gloss_weight)
    terms = image_terms(material, arriving.irradiance, arriving.stack, flux, seen)
    return ViewTerms(*terms, radiance * model.factor.parameter.detach().exp())


_NOWHERE = Footprint.of(torch.zeros(0, 4), torch.zeros(0, 4))
