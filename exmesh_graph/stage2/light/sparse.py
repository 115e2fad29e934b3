"""Which pixels of a view have rays of their own, and who else these rays count for.

A pixel's neighbours on the same surface see nearly the same through their lobes. In a view of many pixels those at the
crossings of every n-th row and column are enough, with all that these do not speak for.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.shading import brdf
from exmesh_graph.stage2.gbuffer import ViewBuffer
from exmesh_graph.stage2.surface import SurfaceSamples

#: Pixels at the crossings of a view at least. They are a 400 x 400 picture's, whose object fills a quarter of it: what
#: a larger one adds is nearer to its neighbours.
CROSSINGS = 40_000
#: Crossings speak for a pixel between them where their shares come to this at least; else it is measured itself.
HEARD = 0.5


class Sparse(NamedTuple):
    """M of a view's N pixels that are measured, and what the others take from them.

    rows    int64 [M]
    near    int64 [M, 4], by their place in `rows`, and share [M, 4]: whose rays count with a pixel's own, and how far
    others  int64 [N - M];  corners int64 [N - M, 4], by their place in `rows`, and weight [N - M, 4], of sum 1
    """

    rows: torch.Tensor
    near: torch.Tensor
    share: torch.Tensor
    others: torch.Tensor
    corners: torch.Tensor
    weight: torch.Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, buffer: ViewBuffer, surface: SurfaceSamples, roughness: torch.Tensor, every: int) -> Sparse:
        """The crossings of every n-th row and column, which count with the four crossings next to them, and pixels that
        these do not speak for, which count with those of their kind beside them."""
        near, share = find_near(buffer, surface, roughness, every)
        crossing = buffer.crossings(every)
        heard = share.sum(1)
        measured = crossing | (heard < HEARD)
        rows, others = torch.nonzero(measured)[:, 0], torch.nonzero(~measured)[:, 0]
        alone = torch.nonzero(~crossing[rows])[:, 0]
        own, shared = near[rows].long(), share[rows]
        beside = buffer.neighbours.long()[rows[alone]]
        beside = torch.where(measured[beside], beside, rows[alone][:, None])
        own[alone], shared[alone] = beside, shared_lobes(surface, roughness, beside, rows[alone])
        place = torch.zeros(len(surface), dtype=torch.int64, device=rows.device)
        place[rows] = torch.arange(len(rows), device=rows.device)
        weight = share[others] / heard[others, None]
        return cls(rows, place[own], shared, others, place[near[others].long()], weight)

    def spread(self, factor: torch.Tensor) -> torch.Tensor:
        """Values [N, 3] of all pixels from those [M, 3] of the measured ones."""
        whole = factor.new_empty(len(self.rows) + len(self.others), 3)
        whole[self.rows] = factor
        whole[self.others] = (factor[self.corners] * self.weight[..., None]).sum(1)
        return whole


def spacing(pixels: int, crossings: int | None = None) -> int:
    """n such that every n-th row and column of a view of so many `pixels` leave `crossings` (None: CROSSINGS) at least;
    1: all."""
    return max(1, math.isqrt(pixels // (crossings or CROSSINGS)))


def shared_lobes(
    surface: SurfaceSamples, roughness: torch.Tensor, near: torch.Tensor, of: torch.Tensor | None = None
) -> torch.Tensor:
    """How far the lobes of pixels `near` [N, 4] (the pixel itself: none) are those of N pixels: [N, 4], at most 1.

    exp(-(t / 2 alpha)^2) of the angle t between their mirrored directions: half vectors of a lobe spread by alpha.
    `of`: the N pixels' numbers, where they are not all.
    """
    near, here = near.long(), torch.arange(len(surface), device=near.device) if of is None else of
    cosine = (surface.reflected[near] * surface.reflected[here][:, None]).sum(-1)
    share = torch.exp((cosine - 1).clamp_max(0) / (2 * brdf.alpha_of(roughness[here])[:, None] ** 2))
    return share * (near != here[:, None])


def find_near(
    buffer: ViewBuffer, surface: SurfaceSamples, roughness: torch.Tensor, every: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """The crossings about each pixel on its surface, [N, 4], and how far each speaks for it, [N, 4].

    Of a crossing those to its left and right, above and below; of a pixel between crossings the corners about it, by
    `shared_lobes` times how near they are. The pixel itself, with 0, where there is none.
    """
    if roughness.device.type != "cpu" or not roughness.dtype == surface.position.dtype == torch.float32:
        return plain_near(buffer, surface, roughness, every)
    (height, width), count = buffer.box, len(roughness)
    grid = torch.full((height * width,), -1, dtype=torch.int32)
    place = buffer.box_pixel.int()
    grid[buffer.box_pixel] = torch.arange(count, dtype=torch.int32)
    near, share = torch.empty(count, 4, dtype=torch.int32), torch.empty(count, 4)
    split(
        _kernels().find_near, -(-count // int(_kernels().CHUNK)), count, height, width, every, brdf.ALPHA_MIN, place,
        grid, surface.position.contiguous(), surface.flat.contiguous(), surface.reflected.contiguous(),
        roughness.contiguous(), near, share, grain=1,
    )  # fmt: skip
    return near, share


def plain_near(
    buffer: ViewBuffer, surface: SurfaceSamples, roughness: torch.Tensor, every: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """`find_near` in torch: the reference, and the form of other devices and dtypes."""
    (height, width), itself = buffer.box, torch.arange(len(roughness), device=roughness.device)
    grid = torch.full((height + 2 * every, width + 2 * every), -1, device=roughness.device)
    row, column = every + buffer.box_pixel // width, every + buffer.box_pixel % width
    grid[row, column] = itself
    down, right = row % every, column % every
    crossing = (down == 0) & (right == 0)
    places, parts = [], []
    for k, (across, over) in enumerate([(0, -every), (0, every), (-every, 0), (every, 0)]):
        a, b = divmod(k, 2)
        places.append(
            grid[
                torch.where(crossing, row + across, row - down + a * every),
                torch.where(crossing, column + over, column - right + b * every),
            ]
        )
        y, x = down / every, right / every
        parts.append(torch.where(crossing, torch.ones_like(y), (y if a else 1 - y) * (x if b else 1 - x)))
    near, part = torch.stack(places, 1), torch.stack(parts, 1).to(roughness)
    near = torch.where((near < 0) | (part == 0), itself[:, None], near)
    near = torch.where(surface.joined(itself[:, None].expand_as(near), near), near, itself[:, None])
    return near, part * shared_lobes(surface, roughness, near)


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.stage2.light import kernels_near

    return kernels_near
