"""A view's pixels as a picture of display values: what D-SSIM and PSNR look at."""

from __future__ import annotations

import torch

from exmesh_graph.losses import SsimTarget, d_ssim, linear_to_srgb, ssim_target
from exmesh_graph.stage2.gbuffer import ViewBuffer


def encode_srgb(linear: torch.Tensor) -> torch.Tensor:
    """Display values of linear colours, clamped to what a file can hold."""
    return linear_to_srgb(linear.clamp(0, 1))


def view_psnr(predicted: torch.Tensor, buffer: ViewBuffer) -> float:
    """PSNR of a view's pixels in sRGB [dB]."""
    error = ((encode_srgb(predicted) - encode_srgb(buffer.target)) ** 2).mean()
    return float(-10 * torch.log10(error.clamp_min(1e-10)))


def view_d_ssim(predicted: torch.Tensor, buffer: ViewBuffer) -> torch.Tensor:
    """D-SSIM in sRGB over the box of the view's pixels, black around them: its sum over them by their number.

    log-L1 is a mean over these pixels too, so lambda_ssim weighs the two as in Stage I, where both are means over the
    whole picture.
    """
    return _per_pixel(_boxed(encode_srgb(predicted), buffer), buffer)


def display_d_ssim(image: torch.Tensor, buffer: ViewBuffer) -> tuple[torch.Tensor, torch.Tensor]:
    """`view_d_ssim` of display values `image` [pixels of the box, 3], and its gradient in them."""
    with torch.enable_grad():
        boxed = image.reshape(*buffer.box, 3).requires_grad_()
        value = _per_pixel(boxed, buffer)
        (gradient,) = torch.autograd.grad(value, boxed)
    return value.detach(), gradient.reshape(-1, 3).contiguous()


def _per_pixel(image: torch.Tensor, buffer: ViewBuffer) -> torch.Tensor:
    height, width = buffer.box
    return d_ssim(image, _target(buffer)) * (height * width / len(buffer.pixel))


def _target(buffer: ViewBuffer) -> SsimTarget:
    if buffer.ssim is None:
        buffer.ssim = ssim_target(_boxed(encode_srgb(buffer.target), buffer))
    return buffer.ssim


def _boxed(values: torch.Tensor, buffer: ViewBuffer) -> torch.Tensor:
    height, width = buffer.box
    blank = torch.zeros(height * width, 3, dtype=values.dtype, device=values.device)
    return blank.index_copy(0, buffer.box_pixel, values).reshape(height, width, 3)
