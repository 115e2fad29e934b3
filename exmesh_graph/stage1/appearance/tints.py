"""Colours of vertices by the direction of view as kernels that all cores share; float32 on a CPU.

Plain forms, which they are tested against and which everything else takes: `directional.plain_tints`, the step of
`optim.adam_step`.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.optim import FIRST, SECOND


@cache
def kernels() -> Any:
    """The module of Warp kernels, imported after `warp()` has been configured."""
    warp()
    from exmesh_graph.stage1.appearance import kernels_tints

    return kernels_tints


def fused_tints(
    vertices: torch.Tensor, residual: torch.Tensor, mean: torch.Tensor, eye: tuple[float, float, float]
) -> torch.Tensor:
    """Tints [V, 3] of vertices [V, 3] seen from `eye`, by residual [V, 3 K] and mean [V, K], K 3 or 8; differentiable
    in vertices and residual."""
    return _Tints.apply(vertices, residual, mean, eye)


class _Tints(torch.autograd.Function):
    @staticmethod
    def forward(ctx, vertices, residual, mean, eye):  # type: ignore[no-untyped-def]
        ctx.given = len(vertices), mean.shape[1], *eye, vertices.detach(), residual.detach(), mean
        out = torch.empty_like(vertices)
        _launch(kernels().tint_vertices, *ctx.given, out)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        by = [torch.empty_like(ctx.given[k]) for k in (5, 6)]
        _launch(kernels().pull_tints, *ctx.given, gradient.contiguous(), *by)
        return *by, None, None


def step_residual(
    residual: torch.Tensor,
    gradient: torch.Tensor,
    moments: tuple[torch.Tensor, torch.Tensor],
    count: int,
    rate: float,
    *,
    pull: float,
    epsilon: float,
) -> bool:
    """A step of `optim.adam_step` by gradient + pull * residual [V, C], with moments [V, C] and [V]: all in place.

    Returns whether all of that is finite.
    """
    rows, width = residual.shape
    totals = scratch("tint totals", _chunks(rows), torch.float64)[: _chunks(rows)]
    _launch(
        kernels().step_rows, rows, width, pull, 1 - FIRST, 1 - SECOND, 1 - SECOND**count, epsilon,
        -rate / (1 - FIRST**count), gradient.contiguous(), *moments, residual.detach(), totals,
    )  # fmt: skip
    return math.isfinite(float(totals.sum()))


def _launch(kernel: Any, count: int, *rest: Any) -> None:
    split(kernel, _chunks(count), count, *rest, grain=1)


def _chunks(count: int) -> int:
    return -(-count // int(kernels().CHUNK))
