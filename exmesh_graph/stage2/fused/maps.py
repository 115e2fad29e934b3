"""Reading the maps, fused: logits to values to what points see, and the adjoint, without a table of values between.

The texels' values are never stored: a pixel computes those of its four texels. The adjoint gives each stretch of the
table to one item, which adds up what lands there in a fixed order (kernels_maps).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.stage2.maps import PAST_ONE, SLOPE, Footprint, MaterialMaps

#: Points and rows of the table of an item.
POINTS, ROWS = 4096, 16384


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.stage2.fused import kernels_maps

    return kernels_maps


def read_maps(
    maps: MaterialMaps, gain: torch.Tensor, pixels: Footprint, points: Footprint
) -> tuple[torch.Tensor, torch.Tensor]:
    """Material [N, C] of `pixels` and [P, C] of `points`; base colour is divided by `gain` [3].

    Differentiable in `maps.parameter` and `gain`; equal to `MaterialMaps.values`, `CommonFactor.share` and
    `MaterialMaps.read` after each other.
    """
    settings = maps.settings
    logits = 5 if settings.metallic else 4
    return _ReadMaps.apply(maps.parameter, gain, settings.roughness_min, logits, pixels, points, maps)


class _ReadMaps(torch.autograd.Function):
    @staticmethod
    def forward(ctx, parameter, gain, low, logits, pixels, points, maps):  # type: ignore[no-untyped-def]
        span = (1 - low) * (1 + PAST_ONE)
        ctx.save_for_backward(parameter, gain)
        ctx.maps, ctx.shape = maps, (logits, low, span, pixels, points)
        channels = parameter.shape[1]
        found = []
        for where in (pixels, points):
            count = len(where.rows)
            out = torch.empty(count, channels)
            if count:
                split(
                    _kernels().read_maps, -(-count // POINTS), POINTS, count, channels, logits, low, span, SLOPE,
                    gain, parameter, where.rows, where.weight, out, grain=1,
                )  # fmt: skip
            found.append(out)
        return tuple(found)

    @staticmethod
    @once_differentiable
    def backward(ctx, *gradients):  # type: ignore[no-untyped-def]
        parameter, gain = ctx.saved_tensors
        logits, low, span, *places = ctx.shape
        rows, channels = parameter.shape
        lists = []
        for where, gradient in zip(places, gradients, strict=True):
            lists += [len(where.rows), where.order, where.rows, where.weight, gradient.contiguous()]
        items = -(-rows // ROWS)
        spare, ctx.maps.spare = ctx.maps.spare, None
        out = torch.empty_like(parameter) if spare is None or spare.shape != parameter.shape else spare
        del spare  # nobody else may hold what becomes the parameter's gradient: it would be copied
        to_gain, extreme = torch.empty(items, 3, dtype=torch.float64), torch.empty(items)
        split(
            _kernels().scatter_maps, items, ROWS, rows, channels, logits, low, span, SLOPE, gain, parameter, *lists,
            out, to_gain, extreme, grain=1,
        )  # fmt: skip
        ctx.maps.extreme = out.data_ptr(), out._version, float(extreme.max()) if items else 0.0
        return out, to_gain.sum(0).to(gain), None, None, None, None, None
