"""Half resolution in both image directions, and back without crossing edges."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.monte_carlo.points import Points

#: Tangent-plane distance over distance at which a neighbour's weight has fallen by e; power of the normals' cosine.
_SLOPE, _POWER = 0.25, 8
#: Weight of a coarse point that lies outside the pixel's tent: it counts only where nothing else does.
_LEAST = 1e-3


@dataclass(frozen=True)
class Coarse:
    """One point for each 2 x 2 block of pixels: rows int64 [L] of the points, and for every point the coarse points
    int64 [N, 4] that it is interpolated from and their weights [N, 4], which sum to 1."""

    rows: torch.Tensor
    index: torch.Tensor
    weight: torch.Tensor

    def spread(self, values: torch.Tensor) -> torch.Tensor:
        """Values [L, C] of the coarse points at all points, [N, C]; differentiable."""
        return gather_rows(values, self.index, self.weight.to(values))


def coarse_points(points: Points, pixel: torch.Tensor, width: int, corner: int = 0) -> Coarse:
    """Choose the coarse points of an image whose covered pixels are `pixel` int64 [N] (row-major), and weigh them.

    Weights are a tent of two pixels times exp(-(tangent-plane slope / 0.25)^2) max(n.n', 0)^8: free of any scale, 0
    across silhouettes, depth steps and creases. A point that no coarse one resembles takes its own block's.
    corner    which pixel of a block to prefer, 0 to 3; a caller that turns it from step to step visits all
    """
    y, x = torch.div(pixel, width, rounding_mode="floor"), pixel % width
    across, down = (width + 1) // 2 + 2, (int(y.max()) + 1 if len(y) else 0) // 2 + 3
    block = (torch.div(y, 2, rounding_mode="floor") + 1) * across + torch.div(x, 2, rounding_mode="floor") + 1
    # the covered pixel of the block that comes first, counted from the preferred corner
    order = ((y % 2) * 2 + x % 2 - corner) % 4
    key = block * 4 + order
    arranged = torch.argsort(key, stable=True)
    leading = torch.ones_like(arranged, dtype=torch.bool)
    leading[1:] = block[arranged][1:] != block[arranged][:-1]
    rows = arranged[leading]
    table = torch.full((across * down,), -1, dtype=torch.int64, device=pixel.device)
    table[block[rows]] = torch.arange(len(rows), device=pixel.device)
    # seen from its own block's coarse point, a pixel lies towards the block after it (before it, for a far corner)
    right, below = 1 - 2 * (corner % 2), (1 - 2 * (corner // 2)) * across
    candidates = torch.stack([block, block + right, block + below, block + right + below], dim=1)
    index = table[candidates]
    there = index >= 0
    index = index.clamp_min(0)
    near = rows[index]
    tent = _tent(x[:, None] - x[near]) * _tent(y[:, None] - y[near])
    weight = torch.where(there, tent * _likeness(points, near), torch.zeros_like(tent))
    weight[:, 0] += 1e-12
    return Coarse(rows, index, weight / weight.sum(1, keepdim=True))


def _tent(distance: torch.Tensor) -> torch.Tensor:
    return (1 - distance.abs() / 2).clamp_min(_LEAST)


def _likeness(points: Points, near: torch.Tensor) -> torch.Tensor:
    step = points.position[near] - points.position[:, None]
    length = step.norm(dim=-1)
    away = torch.maximum((step * points.flat[:, None]).sum(-1).abs(), (step * points.flat[near]).sum(-1).abs())
    slope = away / length.clamp_min(1e-20)
    cosine = (points.normal[:, None] * points.normal[near]).sum(-1).clamp_min(0)
    return torch.exp(-((slope / _SLOPE) ** 2)) * cosine**_POWER
