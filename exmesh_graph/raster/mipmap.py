"""Mip-maps: averaged copies of a texture at half, a quarter ... of its size, chosen by the pixel's footprint.

Plain torch over `sample_texture`, so any float type and device; differentiable in texels, uv and level.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from exmesh_graph.raster.texture import Wrap, sample_texture


def mip_pyramid(texture: torch.Tensor, levels: int | None = None) -> list[torch.Tensor]:
    """`texture` [H, W, C] and its averages over 2 x 2 texels, at most `levels` of them in all (None: down to 1 x 1).

    Sides of odd length n go to n // 2 by averages over windows that overlap by a texel.
    """
    pyramid = [texture]
    while max(pyramid[-1].shape[:2]) > 1 and (levels is None or len(pyramid) < levels):
        height, width, _ = pyramid[-1].shape
        planes = pyramid[-1].permute(2, 0, 1)
        smaller = torch.nn.functional.adaptive_avg_pool2d(planes, (max(height // 2, 1), max(width // 2, 1)))
        pyramid.append(smaller.permute(1, 2, 0))
    return pyramid


def mip_level(footprint: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Level [...] of a pixel whose screen derivative of uv is `footprint` [..., 2, 2] (`interpolate.uv_footprint`).

    log2 of the longer of the two sides, in texels of a height x width texture, of the parallelogram that the pixel
    covers; 0 where a pixel is no larger than a texel (OpenGL's isotropic rule).
    """
    size = footprint.new_tensor([width, height])
    squared = (footprint * size[:, None]).square().sum(-2).amax(-1)
    return 0.5 * torch.log2(squared.clamp(min=1.0))


def sample_mipmap(
    pyramid: Sequence[torch.Tensor], uv: torch.Tensor, level: torch.Tensor, *, wrap: Wrap = "clamp"
) -> torch.Tensor:
    """Trilinear values [..., C] at `uv` [..., 2] and `level` [...]: bilinear in the two levels around it, mixed.

    Levels outside the pyramid are held at its ends (no gradient to `level` there). Each point is looked up in its own
    two levels only. Differentiable in the pyramid's textures, `uv` and `level`.
    """
    channels = pyramid[0].shape[-1]
    points, level = uv.reshape(-1, 2), level.reshape(-1).clamp(0, len(pyramid) - 1)
    low = level.detach().floor()
    upper = level - low
    out = points.new_zeros((len(points), channels))
    for number, texture in enumerate(pyramid):
        here = torch.nonzero((low == number) | ((low == number - 1) & (upper.detach() > 0)))[:, 0]
        if len(here):
            weight = torch.where(low[here] == number, 1 - upper[here], upper[here])
            value = sample_texture(texture, points[here], wrap=wrap)
            out = out.index_add(0, here, weight[:, None] * value)
    return out.view(*uv.shape[:-1], channels)
