"""The sRGB curves, with finite gradients everywhere."""

from __future__ import annotations

import torch


def linear_to_srgb(linear: torch.Tensor) -> torch.Tensor:
    """IEC 61966-2-1 encoding; negative input stays on the linear segment. No upper clamp.

    The power's argument is held above the switch point, so that the unused branch has no infinite gradient at 0.
    """
    power = 1.055 * linear.clamp(min=0.0031308).pow(1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, power)


def srgb_to_linear(encoded: torch.Tensor) -> torch.Tensor:
    """The inverse of `linear_to_srgb`, likewise with finite gradients everywhere."""
    power = ((encoded.clamp(min=0.04045) + 0.055) / 1.055).pow(2.4)
    return torch.where(encoded <= 0.04045, encoded / 12.92, power)


def display(rgb: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Display image over black: sRGB(clip(rgb / alpha)) * alpha, from linear premultiplied `rgb` [..., 3].

    `alpha` [...]; 0 where nothing is covered.
    """
    covered = alpha > 1e-6
    straight = rgb / torch.where(covered, alpha, 1.0)[..., None]
    encoded = linear_to_srgb(straight.clamp(0, 1)) * alpha[..., None]
    return torch.where(covered[..., None], encoded, 0.0)


def _planes(image: torch.Tensor) -> torch.Tensor:
    return (image if image.dim() == 3 else image[..., None]).permute(2, 0, 1)[None].contiguous()
