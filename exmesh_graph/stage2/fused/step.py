"""The terms of a step by fused kernels: what the default fit on a CPU runs.

Maps are read where they are needed (fused.maps). Under the precomputed light a view's pixels are shaded and compared in
one pass (fused.view), and sky and transport stay with autograd; under the sampled one the estimators' own kernels
shade. Normal maps under the precomputed light, other devices and dtypes: `objective.plain_terms`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch

from exmesh_graph.losses import log_l1, pair_variation
from exmesh_graph.shading import envmap
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Drawn
from exmesh_graph.shading.moving import turned
from exmesh_graph.shading.specular import scattered
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fused.maps import read_maps
from exmesh_graph.stage2.fused.view import SeenView, image_terms
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.light.precomputed import PrecomputedLight
from exmesh_graph.stage2.light.sampled import SampledLight, blended, surface_material
from exmesh_graph.stage2.maps import LOG_FLOOR, Appearance, Footprint, Material
from exmesh_graph.stage2.pictures import view_d_ssim


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
    sampled = isinstance(model.light, SampledLight)
    by_transport = isinstance(model.light, PrecomputedLight) and not model.settings.normal_map
    return plain and (sampled or by_transport) and model.maps.size > 1


def view_terms(model: Decomposition, buffer: ViewBuffer, strength: float, step: int) -> ViewTerms:
    """The terms of one view with lambda_ind = `strength`; differentiable in maps, sky and common factor."""
    radiance, gain = envmap.radiance_of(model.environment), model.factor.parameter.exp()
    of = _under_samples if isinstance(model.light, SampledLight) else _under_transport
    sky = radiance * gain
    if model.turns is not None:
        sky = turned(sky, model.turns[buffer.number])
    *terms, predicted = of(model, buffer, sky, gain, Moment(strength, step))
    log_l1, d_ssim, variation = terms
    return ViewTerms(log_l1, d_ssim, variation, predicted, radiance * model.factor.parameter.detach().exp())


class Moment(NamedTuple):
    """Of a fit: lambda_ind, and the step that samples are numbered by."""

    strength: float
    step: int


def _under_transport(
    model: Decomposition, buffer: ViewBuffer, environment: torch.Tensor, gain: torch.Tensor, now: Moment
) -> tuple[torch.Tensor, ...]:
    """log-L1, D-SSIM, variation and radiance [N, 3]; equations: 12, 20, 21, 23."""
    light, settings = model.light, model.settings
    assert isinstance(light, PrecomputedLight)
    bounced = light.operators.bounces > 0 and now.strength > 0
    points = light.footprint(model.maps) if bounced else NOWHERE
    material, sent = read_maps(model.maps, gain, buffer.footprint, points)
    diffuse = scattered(sent[:, :3], sent[:, 3], sent[:, 4] if settings.metallic else None) if bounced else None
    arriving = light.arriving(environment, diffuse, now.strength)
    flux, transfer = arriving.irradiance[:0], arriving.irradiance[:0]
    if light.suns is not None and arriving.flux is not None:
        flux, transfer = arriving.flux, light.suns.views[buffer.number]
    exposure = 1.0 if model.exposure is None else float(model.exposure.gain(buffer.number))
    seen = SeenView(
        buffer, light.lookup, transfer, exposure, settings.ssim_weight > 0, settings.gloss_weight,
        LOG_FLOOR if settings.variation == "log" else 0.0,
    )  # fmt: skip
    return image_terms(material, arriving.irradiance, arriving.stack, flux, seen)


def _under_samples(
    model: Decomposition, buffer: ViewBuffer, environment: torch.Tensor, gain: torch.Tensor, now: Moment
) -> tuple[torch.Tensor, ...]:
    """As `_under_transport`, by samples of this step; equations: 17 to 21, 23."""
    light, settings, maps = model.light, model.settings, model.maps
    assert isinstance(light, SampledLight)
    bounced = light.settings.bounces > 0 and now.strength > 0
    seen = light.seen(buffer)
    with torch.no_grad():
        before = maps.material(read_maps(maps, gain, buffer.footprint, NOWHERE)[0])
        points = seen.points(before)
    moment = Appearance(maps, maps.parameter[:0], environment, now.strength, now.step)
    drawn = light.draw(buffer, points, before, bounced, moment, EnvSampler(environment))
    # the maps' gradient is written once: pixels, and the hits of the samples that have one, are read together
    material, there = _read_with_hits(model, gain, buffer.footprint, drawn[-1])
    points, here = seen.points(material), surface_material(material)

    def shade(one: Drawn) -> torch.Tensor:
        met = there if one is drawn[-1] else _read_with_hits(model, gain, NOWHERE, one)[1]
        query = light.hit_query(met) if bounced else None
        return light.light.shade(one, points, here, query, environment, now.strength)

    predicted = blended(drawn, shade)
    if model.exposure is not None:
        predicted = predicted * model.exposure.gain(buffer.number)
    zero = predicted.new_zeros(())
    ssim = view_d_ssim(predicted, buffer) if settings.ssim_weight > 0 else zero
    variation = pair_variation(material.varied(settings), buffer.pairs) if settings.variation_weight > 0 else zero
    return log_l1(predicted, buffer.target, buffer.clipped, buffer.coverage), ssim, variation, predicted.detach()


def _read_with_hits(
    model: Decomposition, gain: torch.Tensor, pixels: Footprint, drawn: Drawn
) -> tuple[Material, Material | None]:
    """The material of `pixels`, and of the hits of `drawn` where it has any and they have one."""
    light, maps = model.light, model.maps
    assert isinstance(light, SampledLight)
    if drawn.hits is None or not light.settings.secondary_material:
        return maps.material(read_maps(maps, gain, pixels, NOWHERE)[0]), None
    table, behind = read_maps(maps, gain, pixels, Footprint.of(*light.hit_texels(drawn.hits, maps)))
    return maps.material(table), maps.material(behind)


NOWHERE = Footprint.of(torch.zeros(0, 4), torch.zeros(0, 4))
