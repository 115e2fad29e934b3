"""Bilinear texture lookup with a fast adjoint."""

from __future__ import annotations

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
    nothing = uv.numel() == 0 or texture.numel() == 0
    grad_uv = torch.zeros_like(uv) if with_uv else None
    place = torch.empty(0, dtype=torch.int32, device=texture.device)
    touched = place.long()
    seen = torch.empty(0, dtype=torch.bool, device=texture.device) if seen is None else seen.contiguous().view(-1)
    grad_texture = None
    if with_texture and sparse:
        if not nothing:
            marks = torch.zeros(height * width, dtype=torch.bool, device=texture.device)
            launch(
                kernels("texture").mark_texels,
                uv.numel() // 2,
                uv.view(-1, 2),
                seen,
                height,
                width,
                _wrap_code(wrap),
                marks,
            )
            touched = torch.nonzero(marks)[:, 0]
            # written where touched only: the memory of the rest is never paged in
            place = torch.empty(height * width, dtype=torch.int32, device=texture.device)
            place[touched] = torch.arange(len(touched), dtype=torch.int32, device=texture.device)
        grad_texture = texture.new_zeros((len(touched), channels))
    elif with_texture:
        grad_texture = torch.zeros_like(texture)
    if not nothing and (with_texture or with_uv):
        unused = texture.new_zeros(2)
        launch(
            kernels("texture").sample_bilinear_adjoint,
            uv.numel() // 2,
            texture.view(-1),
            uv.view(-1, 2),
            grad.view(-1),
            seen,
            height,
            width,
            channels,
            _wrap_code(wrap),
            int(with_uv),
            int(with_texture),
            place,
            unused if grad_texture is None else grad_texture.view(-1),
            unused.view(1, 2) if grad_uv is None else grad_uv.view(-1, 2),
        )
    if grad_texture is not None and sparse:
        indices = torch.stack([touched // max(width, 1), touched % max(width, 1)])
        grad_texture = torch.sparse_coo_tensor(
            indices, grad_texture, texture.shape, is_coalesced=True, check_invariants=False
        )
    return grad_texture, grad_uv


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
        height, width, channels = texture.shape
        out = torch.zeros((*uv.shape[:-1], channels), dtype=torch.float32, device=texture.device)
        if out.numel() and texture.numel():
            launch(
                kernels("texture").sample_bilinear,
                uv.numel() // 2,
                texture.view(-1),
                uv.view(-1, 2),
                height,
                width,
                channels,
                code,
                out.view(-1),
            )
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
