"""The image terms of Stage I's usual loss, (1 - l) L1 + l D-SSIM + w |alpha - mask|, with one gradient for their sum.

`terms.Terms` has them one by one in plain torch, as the reference and for everything that is not usual.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph import losses
from exmesh_graph.gpu.cores import split
from exmesh_graph.stage1.runtime import kernels
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.targets import Targets


class ImageTerms(NamedTuple):
    """Weighted terms, scalars whose sum alone has a gradient, and the mean squared error of the image."""

    l1: torch.Tensor
    d_ssim: torch.Tensor
    silhouette: torch.Tensor
    error: float


def image_terms(
    colour: torch.Tensor, alpha: torch.Tensor, targets: Targets, view: int, settings: RefineSettings
) -> ImageTerms:
    """Terms of `colour` [H, W, 3] and `alpha` [H, W] against a view with a mask; float32 on a CPU.

    The gradient of a sum that does not weigh the three alike is refused with a ValueError.

    Equations: 7, 8.
    """
    l1, d_ssim, silhouette, error = _ImageTerms.apply(colour, alpha, targets, view, settings)
    return ImageTerms(l1, d_ssim, silhouette, float(error))


class _ImageTerms(torch.autograd.Function):
    @staticmethod
    def forward(ctx, colour, alpha, targets, view, settings):
        height, width = alpha.shape
        colour, alpha = colour.detach().contiguous(), alpha.detach().contiguous()
        share, d_ssim, in_box = settings.ssim_weight, colour.new_zeros(()), colour.view(-1)[:1]
        box = targets.box(view)
        if share > 0:
            d_ssim, in_box = _d_ssim(box.crop(colour), targets.ssim_target(view))
            d_ssim *= share * box.area / alpha.numel()
        by_colour, by_alpha = (1 - share) / colour.numel(), settings.silhouette_weight / alpha.numel()
        bounds = (box.top, box.bottom, box.left, box.right) if share > 0 else (0, 0, 0, 0)
        k = kernels()
        strips = -(-height // int(k.STRIP))
        grad, grad_alpha = torch.empty_like(colour), torch.empty_like(alpha)
        totals = torch.empty((strips, 3), dtype=torch.float64)
        split(
            k.compare_strips, strips, height, width, *bounds, by_colour, share * box.area / alpha.numel(), by_alpha,
            colour, targets.images[view], alpha, targets.alpha[view], in_box, grad, grad_alpha, totals, grain=4,
        )  # fmt: skip
        distance, square, uncovered = totals.sum(0)
        ctx.save_for_backward(grad, grad_alpha)
        error = square / colour.numel()
        ctx.mark_non_differentiable(error)
        return (distance * by_colour).float(), d_ssim, (uncovered * by_alpha).float(), error

    @staticmethod
    @once_differentiable
    def backward(ctx, l1, d_ssim, silhouette, _):
        if not l1 == d_ssim == silhouette:
            raise ValueError("the image terms have a gradient for their plain sum only")
        grad, grad_alpha = ctx.saved_tensors
        if l1 != 1:
            grad, grad_alpha = grad * l1, grad_alpha * l1
        return grad, grad_alpha, None, None, None


def _d_ssim(image: torch.Tensor, target: losses.SsimTarget) -> tuple[torch.Tensor, torch.Tensor]:
    """D-SSIM of `image` [H, W, 3] and its gradient."""
    with torch.enable_grad():
        image = image.detach().requires_grad_()
        value = losses.d_ssim(image, target)
        (gradient,) = torch.autograd.grad(value, image)
    return value.detach(), gradient.contiguous()
