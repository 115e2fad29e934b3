"""Bilinear texture lookup with a fast adjoint."""

from __future__ import annotations

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.raster.warp_runtime import kernels, launch


def sample_texture(texture: torch.Tensor, uv: torch.Tensor) -> torch.Tensor:
    """Bilinear values [..., C] of `texture` [H, W, C] at `uv` [..., 2]; differentiable in both.

    Texel (i, j) has its centre at u = (j + 0.5) / W, v = 1 - (i + 0.5) / H: v points up, row 0 is the top; outside
    the outermost centres the border is repeated (its gradient in uv is 0). The gradient in uv is computed only when
    `uv` requires one. float32 runs in Warp kernels, any other type in plain torch (`sample_texture_reference`).
    """
    if texture.dtype != torch.float32 or uv.dtype != torch.float32:
        return sample_texture_reference(texture, uv)
    return _SampleTexture.apply(texture, uv)


def sample_texture_reference(texture: torch.Tensor, uv: torch.Tensor) -> torch.Tensor:
    """`sample_texture` in plain torch, for any float type."""
    height, width, _ = texture.shape
    x = (uv[..., 0] * width - 0.5).clamp(0, width - 1)
    y = ((1 - uv[..., 1]) * height - 0.5).clamp(0, height - 1)
    left, top = (p.detach().floor().clamp(max=max(n - 2, 0)).long() for p, n in ((x, width), (y, height)))
    right, bottom = (left + 1).clamp(max=width - 1), (top + 1).clamp(max=height - 1)
    s, t = (x - left)[..., None], (y - top)[..., None]
    upper = torch.lerp(texture[top, left], texture[top, right], s)
    lower = torch.lerp(texture[bottom, left], texture[bottom, right], s)
    return torch.lerp(upper, lower, t)


class _SampleTexture(torch.autograd.Function):
    @staticmethod
    def forward(ctx, texture, uv):
        texture, uv = texture.contiguous(), uv.contiguous()
        ctx.save_for_backward(texture, uv)
        height, width, channels = texture.shape
        out = torch.zeros((*uv.shape[:-1], channels), dtype=torch.float32, device=texture.device)
        if out.numel() and texture.numel():
            flat_uv = uv.view(-1, 2)
            launch(
                kernels().sample_bilinear,
                len(flat_uv),
                texture.view(-1),
                flat_uv,
                height,
                width,
                channels,
                out.view(-1),
            )
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        texture, uv = ctx.saved_tensors
        height, width, channels = texture.shape
        with_texture, with_uv = ctx.needs_input_grad
        grad_texture = torch.zeros_like(texture) if with_texture else None
        grad_uv = torch.zeros_like(uv) if with_uv else None
        if uv.numel() and texture.numel() and (with_texture or with_uv):
            unused = texture.new_zeros(2)
            launch(
                kernels().sample_bilinear_adjoint,
                uv.numel() // 2,
                texture.view(-1),
                uv.view(-1, 2),
                grad.contiguous().view(-1),
                height,
                width,
                channels,
                int(with_uv),
                int(with_texture),
                grad_texture.view(-1) if grad_texture is not None else unused,
                grad_uv.view(-1, 2) if grad_uv is not None else unused.view(1, 2),
            )
        return grad_texture, grad_uv
