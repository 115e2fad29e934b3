"""Bilinear texture lookup with a fast adjoint, and mip-maps: averaged copies chosen by the pixel's footprint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.limits import check_size
from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.raster.runtime import kernels

Wrap = Literal["clamp", "repeat", "mirror"]
"""Beyond the texture: its border's texels, the texture again, or its mirror image again."""


def sample_texture(
    texture: torch.Tensor, uv: torch.Tensor, *, wrap: Wrap = "clamp", sparse: bool = False
) -> torch.Tensor:
    """Bilinear values [..., C] of `texture` [H, W, C] at `uv` [..., 2]; differentiable in both.

    Texel (i, j) has its centre at u = (j + 0.5) / W, v = 1 - (i + 0.5) / H: v points up, row 0 is the top; outside
    the outermost centres `wrap` decides ("clamp": the border is repeated, its gradient in uv is 0). The gradient in uv
    is computed only when `uv` requires one. float32 runs in Warp kernels, any other type in plain torch
    (`sample_texture_reference`).

    sparse   the gradient of `texture` is a coalesced torch.sparse_coo tensor: indices int64 [2, n], the (row, column)
             of the texels that were read, ascending, and values [n, C]. For a large texture of which little is seen;
             `texture` must be a leaf, and the optimiser one that takes sparse gradients (torch.optim.SparseAdam).
             float32 only.
    """
    code = _wrap_code(wrap)
    if texture.dtype != torch.float32 or uv.dtype != torch.float32:
        if sparse:
            raise ValueError("sparse texel gradients need float32")
        return sample_texture_reference(texture, uv, wrap=wrap)
    check_size(texels=texture.numel(), values=uv.numel() // 2 * texture.shape[-1])
    return _SampleTexture.apply(texture, uv, code, sparse)


def sample_texture_reference(texture: torch.Tensor, uv: torch.Tensor, *, wrap: Wrap = "clamp") -> torch.Tensor:
    """`sample_texture` in plain torch, for any float type."""
    height, width, _ = texture.shape
    left, right, s = _texel_pair(uv[..., 0] * width, width, wrap)
    top, bottom, t = _texel_pair((1 - uv[..., 1]) * height, height, wrap)
    s, t = s[..., None], t[..., None]
    upper = torch.lerp(texture[top, left], texture[top, right], s)
    lower = torch.lerp(texture[bottom, left], texture[bottom, right], s)
    return torch.lerp(upper, lower, t)


def sample_adjoint(
    texture: torch.Tensor,
    uv: torch.Tensor,
    grad: torch.Tensor,
    wrap: Wrap,
    with_texture: bool,
    with_uv: bool,
    *,
    sparse: bool = False,
    seen: torch.Tensor | None = None,
) -> tuple[torch.Tensor | None, torch.Tensor | None]:
    """dL/dtexture (dense or sparse) and dL/duv from dL/dvalues `grad` [..., C]; None for what is not asked for.

    Contiguous float32; `seen` bool [...] leaves points out.
    """
    height, width, channels = texture.shape
    code = _wrap_code(wrap)
    nothing = uv.numel() == 0 or texture.numel() == 0
    grad_uv = torch.zeros_like(uv) if with_uv else None
    place = torch.empty(0, dtype=torch.int32, device=texture.device)
    touched = place.long()
    seen = torch.empty(0, dtype=torch.bool, device=texture.device) if seen is None else seen.contiguous().view(-1)
    grad_texture = None
    if with_texture and sparse:
        if not nothing:
            marks = torch.zeros(height * width, dtype=torch.bool, device=texture.device)
            launch(kernels("texture").mark_texels, uv.numel() // 2, uv, seen, height, width, code, marks)
            touched = torch.nonzero(marks)[:, 0]
            # written where touched only: the memory of the rest is never paged in
            place = torch.empty(height * width, dtype=torch.int32, device=texture.device)
            place[touched] = torch.arange(len(touched), dtype=torch.int32, device=texture.device)
        grad_texture = texture.new_zeros((len(touched), channels))
    elif with_texture:
        grad_texture = torch.zeros_like(texture)
    if not nothing and (with_texture or with_uv):
        unused = texture.new_zeros(2)
        asked = (code, int(with_uv), int(with_texture))
        results = [unused if result is None else result for result in (grad_texture, grad_uv)]
        launch(
            kernels("texture").sample_bilinear_adjoint, uv.numel() // 2, texture, uv, grad, seen, *texture.shape,
            *asked, place, *results,
        )  # fmt: skip
    if grad_texture is not None and sparse:
        indices = torch.stack([touched // max(width, 1), touched % max(width, 1)])
        grad_texture = torch.sparse_coo_tensor(
            indices, grad_texture, texture.shape, is_coalesced=True, check_invariants=False
        )
    return grad_texture, grad_uv


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


def _wrap_code(wrap: str) -> int:
    modes = get_args(Wrap)
    if wrap not in modes:
        raise ValueError(f"wrap must be one of {', '.join(modes)}, got {wrap!r}")
    return modes.index(wrap)


def _texel_pair(coordinate: torch.Tensor, size: int, wrap: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(lower texel, upper texel, weight of the upper) of a coordinate in texels."""
    position = coordinate - 0.5
    if wrap == "clamp":
        position = position.clamp(0, size - 1)
        low = position.detach().floor().clamp(max=max(size - 2, 0)).long()
        return low, (low + 1).clamp(max=size - 1), position - low
    below = position.detach().floor()
    pair = torch.stack([below, below + 1]).long()
    if wrap == "repeat":
        pair = pair % size
    else:
        pair = pair % (2 * size)
        pair = torch.minimum(pair, 2 * size - 1 - pair)
    return pair[0], pair[1], position - below


class _SampleTexture(torch.autograd.Function):
    @staticmethod
    def forward(ctx, texture, uv, code, sparse):
        texture, uv = texture.contiguous(), uv.contiguous()
        ctx.save_for_backward(texture, uv)
        ctx.wrap, ctx.sparse = get_args(Wrap)[code], sparse
        out = torch.zeros((*uv.shape[:-1], texture.shape[-1]), dtype=torch.float32, device=texture.device)
        if out.numel() and texture.numel():
            launch(kernels("texture").sample_bilinear, uv.numel() // 2, texture, uv, *texture.shape, code, out)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        texture, uv = ctx.saved_tensors
        with_texture, with_uv = ctx.needs_input_grad[:2]
        by_texture, by_uv = sample_adjoint(
            texture, uv, grad.contiguous(), ctx.wrap, with_texture, with_uv, sparse=ctx.sparse
        )
        return by_texture, by_uv, None, None
