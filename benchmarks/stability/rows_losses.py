"""Rows of the losses and the tone curve."""

from __future__ import annotations

import math

import torch

from benchmarks.stability.table import Reached, row
from exmesh_graph import losses
from exmesh_graph.optim import adam_step

_BOTH = (torch.float32, torch.float64)


@row("losses", "D-SSIM of equal flat images, levels 0 to 1", "loss or largest |gradient|", high=1e-4)
def flat_images() -> Reached:
    reached = []
    for dtype in _BOTH:
        worst = 0.0
        for level in (0.0, 1e-4, 0.3, 0.999, 1.0):
            image = torch.full((40, 40, 3), level, dtype=dtype, requires_grad=True)
            value = losses.d_ssim(image, torch.full((40, 40, 3), level, dtype=dtype))
            (gradient,) = torch.autograd.grad(value, image)
            worst = max(worst, float(value.detach().abs()), _size(gradient))
        reached.append(worst)
    return Reached(*reached)


@row(
    "losses",
    "D-SSIM where float32 variance turns negative: 0.9 with noise of 1e-5",
    "loss and gradient against float64",
    high=1e-4,
)
def negative_variance() -> Reached:
    generator = torch.Generator().manual_seed(0)
    noise = torch.rand(2, 64, 64, 3, generator=generator, dtype=torch.float64) * 1e-5
    found = []
    for dtype in _BOTH:
        image, target = ((0.9 + n).to(dtype) for n in noise)
        value = losses.d_ssim(image.requires_grad_(), target)
        found.append((float(value.detach()), _size(torch.autograd.grad(value, image)[0])))
    return Reached(max(abs(a - b) for a, b in zip(*found, strict=True)))


@row("losses", "D-SSIM over a mask, NaN outside its box; an empty mask", "difference from the clean image", high=1e-6)
def masked() -> Reached:
    reached = []
    for dtype in _BOTH:
        image, target = torch.rand(2, 50, 50, 3, generator=torch.Generator().manual_seed(1), dtype=dtype)
        mask = torch.zeros(50, 50, dtype=torch.bool)
        mask[20:30, 18:33] = True
        clean = float(losses.d_ssim(image, target, mask))
        image[:14], image[:, 40:] = math.nan, math.nan
        box = losses.mask_box(mask)
        crop = box.crop(image).clone().requires_grad_()
        value = losses.d_ssim(crop, box.crop(target), box.crop(mask))
        empty = float(losses.d_ssim(image, target, mask & ~mask))
        size = _size(torch.autograd.grad(value, crop)[0])
        reached.append(abs(float(value.detach()) - clean) + abs(empty) + (0 if size < 1 else math.inf))
    return Reached(*reached)


@row("losses", "D-SSIM in half precision", "dtypes let through", high=0)
def half_precision() -> Reached:
    let_through = 0
    for dtype in (torch.float16, torch.bfloat16):
        image = torch.rand(20, 20, 3).to(dtype)
        try:
            losses.d_ssim(image, image)
            let_through += 1
        except ValueError:
            pass
    return Reached(let_through)


@row("losses", "Pearson depth of a plane facing the camera, 0, 1 and 2 pixels", "loss or |gradient|, if finite", high=0)
def constant_depth() -> Reached:
    reached = []
    for dtype in _BOTH:
        worst = 0.0
        for pixels in (0, 1, 2, 400):
            depth = torch.full((20, 20), 3.3, dtype=dtype, requires_grad=True)
            other = torch.rand(20, 20, generator=torch.Generator().manual_seed(0), dtype=dtype)
            mask = torch.arange(400).reshape(20, 20) < pixels
            value = losses.pearson_depth(depth, other, mask) + 0 * depth.sum()
            worst = max(worst, float(value.detach()), _size(torch.autograd.grad(value, depth)[0]))
        reached.append(worst)
    return Reached(*reached)


@row("losses", "Pearson depth at distance 1000, spread 1", "difference from the same depth at 0", high=1e-3)
def far_depth() -> Reached:
    depth, other = torch.rand(2, 40, 40, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    mask = torch.ones(40, 40, dtype=torch.bool)
    near = float(losses.pearson_depth(depth, other, mask))
    return Reached(*(abs(float(losses.pearson_depth((depth + 1000).to(t), other.to(t), mask)) - near) for t in _BOTH))


@row(
    "losses",
    "BCE of coverage at 0, 1 and beyond; an all-black image and mask",
    "largest |value| or |gradient| per pixel",
    high=1001,
)
def silhouette() -> Reached:
    reached = []
    for dtype in _BOTH:
        worst = 0.0
        for alpha, mask in (([0.0, 1.0, 1.02, -0.01], [1.0, 0.0, 0.0, 1.0]), ([0.0] * 4, [0.0] * 4)):
            value = torch.tensor(alpha, dtype=dtype, requires_grad=True)
            loss = losses.silhouette_bce(value, torch.tensor(mask, dtype=dtype)) * 4
            worst = max(worst, float(loss.detach().abs()), _size(torch.autograd.grad(loss, value)[0]))
        reached.append(worst)
    return Reached(*reached)


@row("losses", "sRGB curve and its inverse at 0, below and at the switch", "largest gradient", low=0.01, high=12.93)
def tone_curve() -> Reached:
    reached = []
    for dtype in _BOTH:
        x = torch.tensor([-1.0, -1e-8, 0, 1e-38, 1e-8, 0.0031308, 0.04045, 1], dtype=dtype, requires_grad=True)
        sizes = [_size(torch.autograd.grad(f(x).sum(), x)[0]) for f in (losses.linear_to_srgb, losses.srgb_to_linear)]
        reached.append(max(sizes))
    return Reached(*reached)


@row("losses", "log-L1 of black and negative radiance, a sun of 1e5", "largest |gradient|, if finite", high=1)
def logarithm() -> Reached:
    reached = []
    for dtype in _BOTH:
        image = torch.tensor([0.0, -1, 1e-30, 1e5], dtype=dtype, requires_grad=True)
        value = losses.log_l1(image, torch.tensor([1.0, 0, 1e5, 0], dtype=dtype)) * 4
        reached.append(_size(torch.autograd.grad(value, image)[0]) if bool(torch.isfinite(value)) else math.inf)
    return Reached(*reached)


@row("texture", "dead gradient of clamp(0, 1): start at 1, target 0.5", "distance left after 200 steps", high=0.01)
def clamped_texture() -> Reached:
    """The projection follows the step, so a texel on the bound still feels its gradient."""
    reached = []
    for dtype in _BOTH:
        texture = torch.full((4, 4, 3), 1.0, dtype=dtype)
        texture[2:] = 0.0
        first, second = torch.zeros_like(texture), torch.zeros_like(texture)
        for step in range(1, 201):
            gradient = 2 * (texture - 0.5)
            adam_step(texture, gradient, first, second, step, 0.01)
            texture.clamp_(0, 1)
        reached.append(float((texture - 0.5).abs().max()))
    return Reached(*reached)


def _size(gradient: torch.Tensor) -> float:
    return float(gradient.abs().max()) if bool(torch.isfinite(gradient).all()) else math.inf
