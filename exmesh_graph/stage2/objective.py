"""The objective of a step: weighted terms of one view, eq. 21 to 24."""

from __future__ import annotations

import torch

from exmesh_graph.losses import log_l1, pair_variation
from exmesh_graph.shading import envmap
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fused import step as fused
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.pictures import view_d_ssim
from exmesh_graph.stage2.settings import DecompositionSettings


def indirect_strength(settings: DecompositionSettings, step: int) -> float:
    """lambda_ind of eq. 20 at `step`: linear from 0 to its target."""
    return settings.indirect_weight * min(1.0, (step + 1) / max(settings.indirect_ramp, 1))


def chroma_strength(settings: DecompositionSettings, step: int) -> float:
    """lambda_chroma at `step`: linear from its start to 0.

    Equation: 24.
    """
    return settings.chroma_weight * (1 - step / settings.iterations)


def metal_strength(settings: DecompositionSettings, step: int) -> float:
    """Weight of undecided metallic at `step`: 0 in the first half, whole from seven tenths of the steps on."""
    return settings.metal_weight * min(1.0, max(0.0, (step / settings.iterations - 0.5) / 0.2))


def weighted_terms(model: Decomposition, buffer: ViewBuffer, step: int) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """The weighted terms of one view, and its predicted radiance [N, 3] (detached).

    Where the fused step serves (stage2.fused.step.serves) its kernels compute them, else `plain_terms`: equal but for
    rounding.

    Equation: 22.
    """
    if not fused.serves(model):
        return plain_terms(model, buffer, step)
    settings = model.settings
    found = fused.view_terms(model, buffer, indirect_strength(settings, step), step)
    terms = {"image": settings.log_weight * found.log_l1}
    if settings.ssim_weight > 0:
        terms["ssim"] = settings.ssim_weight * found.d_ssim
    if settings.variation_weight > 0:
        terms["material"] = settings.variation_weight * found.variation
    return terms | _own_terms(model, found.environment, step), found.predicted


def plain_terms(model: Decomposition, buffer: ViewBuffer, step: int) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """`weighted_terms` by autograd over plain operations, for every light, device and dtype.

    Equation: 22.
    """
    settings = model.settings
    prepared = model.prepare(indirect_strength(settings, step), step)
    predicted, material = model.shade(buffer, prepared)
    terms = image_terms(settings, predicted, buffer)
    if settings.variation_weight > 0:
        terms["material"] = settings.variation_weight * pair_variation(material.varied(settings), buffer.pairs)
    return terms | _own_terms(model, prepared.environment, step), predicted.detach()


def image_terms(
    settings: DecompositionSettings, predicted: torch.Tensor, buffer: ViewBuffer
) -> dict[str, torch.Tensor]:
    """What sets `predicted` [N, 3] apart from the photograph: log-L1 in linear light, D-SSIM of display values,
    (1 - SSIM) / 2 as in Stage I.

    Equation: 21.
    """
    terms = {"image": settings.log_weight * log_l1(predicted, buffer.target, buffer.clipped, buffer.coverage)}
    if settings.ssim_weight > 0:
        terms["ssim"] = settings.ssim_weight * view_d_ssim(predicted, buffer)
    return terms


def _own_terms(model: Decomposition, environment: torch.Tensor, step: int) -> dict[str, torch.Tensor]:
    """Terms of metallic and sky alone, which no pixel has a say in."""
    settings = model.settings
    terms: dict[str, torch.Tensor] = {}
    if settings.metallic and (strength := metal_strength(settings, step)) > 0:
        terms["metal"] = strength * model.maps.undecided()
    if not environment.requires_grad:  # a known light
        return terms
    if settings.environment_weight > 0:
        terms["environment"] = settings.environment_weight * envmap.total_variation(environment)
    if settings.above_weight > 0:
        terms["above"] = settings.above_weight * envmap.too_low(environment)
    if settings.level_weight > 0:
        maps = model.maps.parameter
        terms["level"] = settings.level_weight * model.factor.too_bright(
            maps, maps[:, 4] if settings.metallic else None
        )
    if settings.chroma_weight > 0:
        # left out of the common factor, which then undoes what the term does to the sky, the two would run away
        terms["chroma"] = chroma_strength(settings, step) * envmap.chroma(environment * model.factor.tint())
    return terms
