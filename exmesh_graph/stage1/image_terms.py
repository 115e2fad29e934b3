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


class Compared(NamedTuple):
    """Weighted terms, scalars whose sum alone has a gradient, and the mean squared error of the image."""

    l1: torch.Tensor
    d_ssim: torch.Tensor
    silhouette: torch.Tensor
    error: float


class ImageTerms:
    """The terms of pictures against views with masks; float32 on a CPU. A gradient holds until the next comparison."""

    def __init__(self, targets: Targets, settings: RefineSettings) -> None:
        self.targets, self.settings = targets, settings
        self.grad = torch.empty((targets.height, targets.width, 3))
        self.grad_alpha = torch.empty((targets.height, targets.width))

    def of(self, view: int, colour: torch.Tensor, alpha: torch.Tensor) -> Compared:
        """Of `colour` [H, W, 3] and `alpha` [H, W].

        The gradient of a sum that does not weigh the three alike is refused with a ValueError.

        Equations: 7, 8.
        """
        l1, d_ssim, silhouette, error = _ImageTerms.apply(colour, alpha, view, self)
        return Compared(l1, d_ssim, silhouette, float(error))


class _ImageTerms(torch.autograd.Function):
    @staticmethod
    def forward(ctx, colour, alpha, view, terms):
        targets, weight = terms.targets, terms.settings.ssim_weight
        colour, alpha = colour.detach().contiguous(), alpha.detach().contiguous()
        height, width = alpha.shape
        by_colour, by_alpha = (1 - weight) / colour.numel(), terms.settings.silhouette_weight / alpha.numel()
        box = targets.box(view)
        share = weight * box.area / alpha.numel()
        d_ssim, in_box, bounds = colour.new_zeros(()), colour, (0, 0, 0, 0)
        if weight > 0:
            similarity, in_box = losses.ssim_and_gradient(box.crop(colour), targets.ssim_target(view))
            d_ssim, bounds = share * (1 - similarity) / 2, (box.top, box.bottom, box.left, box.right)
        k = kernels()
        strips = -(-height // int(k.STRIP))
        totals = torch.empty((strips, 3), dtype=torch.float64)
        split(
            k.compare_strips, strips, height, width, *bounds, by_colour, -share / 2, by_alpha, colour,
            targets.images[view], alpha, targets.alpha[view], in_box, terms.grad, terms.grad_alpha, totals, grain=2,
        )  # fmt: skip
        distance, square, uncovered = totals.sum(0)
        ctx.gradients = terms.grad, terms.grad_alpha
        error = square / colour.numel()
        ctx.mark_non_differentiable(error)
        return (distance * by_colour).float(), d_ssim, (uncovered * by_alpha).float(), error

    @staticmethod
    @once_differentiable
    def backward(ctx, l1, d_ssim, silhouette, _):
        if not l1 == d_ssim == silhouette:
            raise ValueError("the image terms have a gradient for their plain sum only")
        scale = float(l1)
        return *(gradient if scale == 1 else gradient * scale for gradient in ctx.gradients), None, None
