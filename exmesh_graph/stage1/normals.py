"""How much the surface's normal varies: the total variation of its normals, which walls without paint need.

    V(x) = p / A sum over edges e of l_e (sqrt(|n - n'|^2 + w^2) - w)

n and n' are the normals of the two faces at e, l_e its length, A the area of all faces and p the width of a pixel (all
three of the start), w the angle (rad) up to which a bend costs by its square. V is the integral of curvature per pixel:
where bends are above w it does not depend on how fine the mesh is, and a crease costs about the same whether it is
sharp or rounded (of 90 degrees 1.41 and 1.57: a chord and its arc). So bumps go and edges stay. (Total variation of
normals: Bergmann et al. 2020, SIAM J. Imaging Sciences 13; here on faces, as a smoothed sum.)
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.raster import EdgeTable
from exmesh_graph.stage1.regularise import PreparedSmoothness
from exmesh_graph.stage1.runtime import vertex_kernels
from exmesh_graph.stage1.vertices import chunks, serves, totals_of

NEEDLE = 1e-4
"""A face below this share of the mean area has no normal that means anything: its edges do not count."""


def normal_variation(
    vertices: torch.Tensor, table: EdgeTable, pixel: float, width: float
) -> Callable[[torch.Tensor], torch.Tensor]:
    """V as a function of moved vertices [V, 3], a scalar; `vertices` are those of the start, `table` their edges.

    pixel  width of one, world units;  width  w > 0, rad
    Edges of one face do not count. Differentiable; by kernels in float32 on a CPU.
    """
    bends = _Bends(vertices.detach(), table, pixel, width)
    if serves(vertices):
        return lambda moved: _Fused.apply(moved, bends) if serves(moved.detach()) else bends.plain(moved)
    return bends.plain


def beside(
    smooth: PreparedSmoothness | None, weight: float, variation: Callable[[torch.Tensor], torch.Tensor]
) -> PreparedSmoothness:
    """The term of `smooth`, and `weight` times `variation`."""
    other = smooth.loss if smooth else None
    if other is None:
        return PreparedSmoothness(lambda moved: weight * variation(moved))
    return PreparedSmoothness(lambda moved: other(moved) + weight * variation(moved))


class _Bends:
    """The edges that two faces share: their corners int64 [E, 4], first the ends, and their weights [E]."""

    def __init__(self, vertices: torch.Tensor, table: EdgeTable, pixel: float, width: float) -> None:
        shared = table.opposite[:, 1] >= 0
        self.corners = torch.cat([table.edges[shared], table.opposite[shared]], dim=1).long()
        self.width = width
        one, other = _normals(vertices, self.corners)
        # an edge stands for a third of either face
        area = float((one.norm(dim=1) + other.norm(dim=1)).double().sum()) / 6 or 1.0
        self.least = NEEDLE * 3 * area / max(len(self.corners), 1)  # of a normal, which is as long as twice an area
        ends = vertices[self.corners[:, :2]]
        self.weight = (ends[:, 1] - ends[:, 0]).norm(dim=1) * (pixel / area)
        order = torch.argsort(self.corners.reshape(-1), stable=True)
        degree = torch.bincount(self.corners.reshape(-1), minlength=len(vertices))
        starts = torch.cat([degree.new_zeros(1), degree.cumsum(0)])
        self.starts, self.rows, self.nodes = (a.int().contiguous() for a in (starts, order, self.corners))

    def plain(self, vertices: torch.Tensor) -> torch.Tensor:
        """The term in torch: the reference, and the form of other devices and dtypes."""
        one, other = _normals(vertices, self.corners)
        first, second = one.norm(dim=1), other.norm(dim=1)
        counts = (first > self.least) & (second > self.least)
        one, other = (n[counts] / size[counts, None] for n, size in ((one, first), (other, second)))
        bend = ((one - other).square().sum(dim=1) + self.width**2).sqrt() - self.width
        return (self.weight[counts] * bend).sum()


def _normals(vertices: torch.Tensor, corners: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Normals [E, 3] of both faces at each edge, as long as twice their areas; turned together or not at all."""
    begin, end, left, right = vertices.index_select(0, corners.reshape(-1)).view(-1, 4, 3).unbind(dim=1)
    along = end - begin
    return torch.linalg.cross(along, left - begin), torch.linalg.cross(right - begin, along)


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(ctx, vertices, bends):
        k, edges, count = vertex_kernels(), len(bends.corners), len(vertices)
        here, totals = vertices.detach(), totals_of(edges)
        pushes = scratch("bends", 12 * edges)[: 12 * edges]
        split(
            k.bend_edges, len(totals), edges, bends.width, bends.least, bends.nodes, bends.weight, here, pushes, totals,
            grain=1,
        )  # fmt: skip
        ctx.gradient = torch.empty_like(here)
        split(k.gather_corners, chunks(count), count, bends.starts, bends.rows, pushes, ctx.gradient, grain=1)
        return vertices.new_tensor(float(totals.sum()))

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        factor = float(grad)
        return ctx.gradient if factor == 1 else ctx.gradient * factor, None
