"""Stage I's operations on vertices and faces as kernels that all cores share; float32 on a CPU.

Each has a plain form in torch, which it is tested against and which everything else takes: `regularise.smoothness`,
`facing.behind`, the steps of `refine`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.optim import FIRST, SECOND
from exmesh_graph.stage1.runtime import vertex_kernels


class Neighbours(NamedTuple):
    """Of each vertex: beside[starts[v]:starts[v + 1]], int32, and one over their number, float32 (0 for none)."""

    starts: torch.Tensor
    beside: torch.Tensor
    inverse: torch.Tensor


def neighbours(count: int, edges: torch.Tensor) -> Neighbours:
    """Over undirected edges int64 [E, 2], each given once."""
    ends = torch.cat([edges, edges.flip(1)])
    ends = ends[torch.argsort(ends[:, 0] * max(count, 1) + ends[:, 1])]
    degree = torch.bincount(ends[:, 0], minlength=count)
    starts = torch.cat([degree.new_zeros(1), degree.cumsum(0)]).to(torch.int32)
    inverse = torch.where(degree > 0, 1 / degree.clamp(min=1).float(), 0.0)
    return Neighbours(starts, ends[:, 1].to(torch.int32).contiguous(), inverse)


def serves(*tensors: torch.Tensor) -> bool:
    """Whether the kernels compute with the tensors."""
    return all(t.device.type == "cpu" and t.dtype == torch.float32 and t.is_contiguous() for t in tensors)


def unevenness(vertices: torch.Tensor, of: Neighbours, times: int, scale: float) -> torch.Tensor:
    """scale |U^times v|^2, U v = mean of v's neighbours - v, with one gradient; differentiable in `vertices` [V, 3]."""
    return _Unevenness.apply(vertices, of, times, scale)


class _Unevenness(torch.autograd.Function):
    @staticmethod
    def forward(ctx, vertices, of, times, scale):
        size = 3 * len(vertices)
        # forwards x -> a -> (b), back the transposed: the last pass writes the gradient
        here = vertices.detach().contiguous()
        kept = [scratch(f"unevenness {k}", size)[:size] for k in range(2)]
        total = 0.0
        for k in range(times):
            total = _umbrella(of, here, kept[k % 2], 0, 1.0)
            here = kept[k % 2]
        ctx.gradient = torch.empty_like(vertices, memory_format=torch.contiguous_format)
        for k in range(times):
            last = k == times - 1
            to = ctx.gradient if last else kept[(times + k) % 2]
            _umbrella(of, here, to, 1, 2 * scale if last else 1.0)
            here = to
        return vertices.new_tensor(scale * total)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        factor = float(grad)
        return ctx.gradient if factor == 1 else ctx.gradient * factor, None, None, None


def _umbrella(of: Neighbours, x: torch.Tensor, out: torch.Tensor, transposed: int, factor: float) -> float:
    """The sum of squares of what is written to `out`."""
    k, count = vertex_kernels(), len(of.inverse)
    totals = totals_of(count)
    split(k.umbrella, len(totals), count, transposed, factor, *of, x, out, totals, grain=1)
    return float(totals.sum())


def step(
    vertices: torch.Tensor,
    gradient: torch.Tensor,
    per_area: torch.Tensor,
    mean: torch.Tensor,
    moments: tuple[torch.Tensor, torch.Tensor],
    number: int,
    rate: float,
    *,
    decay: float,
    epsilon: float,
) -> float:
    """A step of `optim.adam_step` by gradient * per_area, and mean.lerp_(|gradient|, 1 - decay): all in place.

    vertices, gradient [V, 3], per_area [V, 1], mean [V], moments [V, 3] and [V]; the others as in `adam_step`.
    Returns the sum of the gradient's norms, which is not finite if a gradient is not.
    """
    totals = totals_of(len(vertices))
    split(
        vertex_kernels().step_vertices, len(totals), len(vertices), 1 - decay, 1 - FIRST, 1 - SECOND,
        1 - SECOND**number, epsilon, -rate / (1 - FIRST**number), gradient.contiguous(), per_area, mean, *moments,
        vertices.detach(), totals, grain=1,
    )  # fmt: skip
    return float(totals.sum())


def any_turned(projected: torch.Tensor, faces: torch.Tensor, shown: torch.Tensor) -> bool:
    """Whether any face int32 [F, 3] that is `shown`, uint8 [F], is seen from behind at `projected` [V, 3]."""
    totals = totals_of(len(faces), torch.int32)
    split(
        vertex_kernels().count_turned, len(totals), len(faces), projected.detach().contiguous(), faces, shown, totals,
        grain=1,
    )  # fmt: skip
    return bool(totals.any())


def totals_of(count: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """One for each chunk of `count` vertices, edges or faces."""
    size = chunks(count)
    return scratch(f"vertex totals {dtype}", size, dtype)[:size]


def chunks(count: int) -> int:
    """The items of a launch over `count` vertices, edges or faces."""
    return -(-count // int(vertex_kernels().CHUNK))
