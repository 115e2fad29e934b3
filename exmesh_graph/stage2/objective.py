"""The objective of a step: weighted terms of one view, eq. 21 to 24."""

from __future__ import annotations

import torch

from exmesh_graph.losses import d_ssim, linear_to_srgb, log_l1, pair_variation, ssim_target
from exmesh_graph.shading import envmap
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.settings import DecompositionSettings


def indirect_strength(settings: DecompositionSettings, step: int) -> float:
    """lambda_ind of eq. 20 at `step`: linear from 0 to its target."""
    return settings.indirect_weight * min(1.0, (step + 1) / max(settings.indirect_ramp, 1))


def chroma_strength(settings: DecompositionSettings, step: int) -> float:
    """lambda_chroma at `step`: linear from its start to 0.

    Equation: 24.
    """
    return settings.chroma_weight * (1 - step / settings.iterations)


def weighted_terms(model: Decomposition, buffer: ViewBuffer, step: int) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """The weighted terms of one view, and its predicted radiance [N, 3] (detached).

    Equation: 22.
    """
    settings = model.settings
    prepared = model.prepare(indirect_strength(settings, step), step)
    predicted, material = model.shade(buffer, prepared)
    terms = image_terms(settings, predicted, buffer)
    if settings.material_weight > 0:
        terms["material"] = settings.material_weight * pair_variation(material.table, buffer.pairs)
    if not prepared.environment.requires_grad:  # a known light
        return terms, predicted.detach()
    if settings.environment_weight > 0:
        terms["environment"] = settings.environment_weight * envmap.total_variation(prepared.environment)
    if settings.chroma_weight > 0:
        terms["chroma"] = chroma_strength(settings, step) * envmap.chroma(prepared.environment)
    return terms, predicted.detach()


def image_terms(
    settings: DecompositionSettings, predicted: torch.Tensor, buffer: ViewBuffer
) -> dict[str, torch.Tensor]:
    """What sets `predicted` [N, 3] apart from the photograph: log-L1 in linear light, D-SSIM of display values,
    (1 - SSIM) / 2 as in Stage I.

    Equation: 21.
    """
    terms = {"image": settings.log_weight * log_l1(predicted, buffer.target, buffer.clipped, buffer.coverage)}
    if settings.ssim_weight > 0:
        terms["ssim"] = settings.ssim_weight * _d_ssim(predicted, buffer)
    return terms


def view_psnr(predicted: torch.Tensor, buffer: ViewBuffer) -> float:
    """PSNR of a view's pixels in sRGB [dB]."""
    error = ((encode_srgb(predicted) - encode_srgb(buffer.target)) ** 2).mean()
    return float(-10 * torch.log10(error.clamp_min(1e-10)))


def encode_srgb(linear: torch.Tensor) -> torch.Tensor:
    """Display values of linear colours, clamped to what a file can hold."""
    return linear_to_srgb(linear.clamp(0, 1))


def _d_ssim(predicted: torch.Tensor, buffer: ViewBuffer) -> torch.Tensor:
    """D-SSIM in sRGB over the box of the view's pixels, black around them: its sum over them by their number.

    log-L1 is a mean over these pixels too, so lambda_ssim weighs the two as in Stage I, where both are means over the
    whole picture.
    """
    height, width = buffer.box
    if buffer.ssim is None:
        buffer.ssim = ssim_target(_image(encode_srgb(buffer.target), buffer.box_pixel, height, width))
    mean = d_ssim(_image(encode_srgb(predicted), buffer.box_pixel, height, width), buffer.ssim)
    return mean * (height * width / len(buffer.pixel))


def _image(values: torch.Tensor, pixel: torch.Tensor, height: int, width: int) -> torch.Tensor:
    blank = torch.zeros(height * width, 3, dtype=values.dtype, device=values.device)
    return blank.index_copy(0, pixel, values).reshape(height, width, 3)
