"""The image terms of one view under the precomputed light, fused: one pass over its pixels for the values, one back.

Equal to `PrecomputedLight.radiance` followed by `losses.log_l1`, D-SSIM and `losses.pair_variation`, whose autograd it
is tested against.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.shading.specular import LEVELS, PrefilteredStack
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.pictures import display_d_ssim

#: Pixels of an item of the pass forward.
PIXELS = 4096
#: Items of the pass back, each with sums of its own for irradiance and stack, and the least pixels of one.
ITEMS, LEAST = 8, 8192
#: Floats of the tables that an item adds up at once.
SUMMED = 1 << 15


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.stage2.fused import kernels_view

    return kernels_view


@dataclass(frozen=True)
class SpecularTables:
    """What the split sum looks up: levels int32 [L, 3] (height, width, first row), knots [L], A and B [64, 64, 2]."""

    levels: torch.Tensor
    knots: torch.Tensor
    reflectance: torch.Tensor

    @classmethod
    def of(cls, stack: PrefilteredStack, reflectance: torch.Tensor) -> SpecularTables:
        levels = torch.stack([stack.heights, stack.widths, stack.starts], dim=1).to(torch.int32)
        return cls(levels.contiguous(), torch.tensor(LEVELS), reflectance.contiguous())


@dataclass(frozen=True)
class SeenView:
    """A view whose terms are asked for: its suns' transfer [N, S], its exposure, whether D-SSIM is wanted, and how much
    the variation of roughness and metallic counts against that of base colour, and what base colour is raised by before
    its logarithm is taken in it (0: no logarithm)."""

    buffer: ViewBuffer
    tables: SpecularTables
    transfer: torch.Tensor
    exposure: float
    ssim: bool
    gloss: float = 1.0
    floor: float = 0.0


def image_terms(
    material: torch.Tensor, irradiance: torch.Tensor, stack: torch.Tensor, flux: torch.Tensor, view: SeenView
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """log-L1, D-SSIM and the materials' variation of a view, unweighted, and its radiance [N, 3] (detached).

    material [N, 4 or 5], irradiance [P, 3], stack [S, 3] (PrefilteredStack.build), flux of the suns [any, 3]: float32
    on the CPU; differentiable in all four.

    Equations: 12, 20, 21, 23.
    """
    return _ImageTerms.apply(material, irradiance, stack, flux, view)


class _ImageTerms(torch.autograd.Function):
    @staticmethod
    def forward(ctx, material, irradiance, stack, flux, view):  # type: ignore[no-untyped-def]
        buffer, tables, light = view.buffer, view.tables, view.buffer.light
        count, channels = material.shape
        height, width = buffer.box
        predicted, record = torch.empty(count, 3), _record((count + 7) // 8 * 8 * _kernels().RECORD)
        image = torch.zeros(height * width if view.ssim else 0, 3)
        shared = (
            count, channels, view.exposure, material, predicted, record, light.point, light.point_weight,
            len(flux), view.transfer, light.env_u, light.env_v, light.specular_scale,
        )  # fmt: skip
        looked_up = (buffer.box_pixel, tables.levels, tables.knots)
        items = -(-count // PIXELS)
        sums = torch.empty(items, 2, dtype=torch.float64)
        split(
            _kernels().shade_view, items, PIXELS, *shared, buffer.target, buffer.clipped, buffer.coverage, *looked_up,
            buffer.n_v, _rows_of_four(irradiance), _rows_of_four(flux), _rows_of_four(stack), tables.reflectance,
            buffer.neighbours, view.gloss, view.floor, image, sums, grain=1,
        )  # fmt: skip
        miss, steps = sums.sum(0).tolist()
        weight = 3 * float(buffer.coverage.sum(dtype=torch.float64))
        ctx.per_pixel = 1 / weight if weight else math.nan  # the mean over no pixels
        ctx.per_step = 1 / max(len(buffer.pairs) * channels, 1)
        ssim, to_image = display_d_ssim(image, buffer) if view.ssim and count else (torch.zeros(()), image)
        ctx.record, ctx.given = record, False
        ctx.shared, ctx.looked_up, ctx.to_image = shared, looked_up, to_image
        ctx.sizes = len(irradiance), len(stack), len(flux)
        ctx.mark_non_differentiable(predicted)
        terms = torch.tensor([miss * ctx.per_pixel, steps / 2 * ctx.per_step], dtype=torch.float64).float()
        return terms[0].clone(), ssim, terms[1].clone(), predicted

    @staticmethod
    @once_differentiable
    def backward(ctx, by_miss, by_ssim, by_steps, _):  # type: ignore[no-untyped-def]
        # not in the key: it raises
        if ctx.given and _spare.__dict__.get("record") is not ctx.record:
            raise RuntimeError("a view's terms are differentiated again after another view's were computed")
        count, channels = ctx.shared[:2]
        points, rows, suns = ctx.sizes
        grain = max(LEAST, -(-count // (8 * ITEMS)) * 8)
        items = -(-count // grain)
        even, whole = points + points % 2, (rows + rows % 2) * ctx.needs_input_grad[2]
        to_material = torch.empty(count, channels)
        tables = [torch.empty(items, size, 4) for size in (even, suns, whole)]
        split(
            _kernels().pull_back, items, grain, *ctx.shared, *ctx.looked_up, float(by_miss) * ctx.per_pixel,
            float(by_ssim), ctx.to_image, float(by_steps) * ctx.per_step, even, whole, to_material, *tables, grain=1,
        )  # fmt: skip
        _spare.record, ctx.given = ctx.record, True  # not in the key: room to be written over
        to_irradiance, to_flux, to_stack = (_sum(table)[:, :3] for table in tables)
        return to_material, to_irradiance[:points], to_stack[:rows] if whole else None, to_flux[:suns], None


_spare = threading.local()


def _record(size: int) -> torch.Tensor:
    """Memory of a view between its two passes: that of an earlier view which has had both, where it is large enough."""
    kept = _spare.__dict__.pop("record", None)  # not in the key: room to be written over
    return torch.empty(size) if kept is None or len(kept) < size else kept


def _rows_of_four(values: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.pad(values, (0, 1))


def _sum(pieces: torch.Tensor) -> torch.Tensor:
    """[items, R, 4] to [R, 4], in the items' order."""
    size = pieces[0].numel()
    if size % 8:  # a few suns
        return pieces.sum(0)
    if size and len(pieces) > 1:
        split(_kernels().add_pieces, -(-size // SUMMED), SUMMED, size, len(pieces), pieces, grain=1)
    return pieces[0]
