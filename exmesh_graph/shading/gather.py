"""Weighted sums of table rows: the one access pattern of textures, lattices and environments."""

from __future__ import annotations

import torch
import torch.nn.functional as F


def gather_rows(table: torch.Tensor, index: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """sum_j weight[n, j] table[index[n, j]]: [N, C] from table [T, C], index int64 [N, J], weight [N, J].

    Differentiable in table and weight. Equal to `(table[index] * weight[..., None]).sum(1)`, without its
    [N, J, C] copies and with an adjoint that adds rows in a fixed order.
    """
    return _GatherRows.apply(table, index, weight)


class _GatherRows(torch.autograd.Function):
    @staticmethod
    def forward(ctx, table, index, weight):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(table, index, weight)
        return F.embedding_bag(index, table, per_sample_weights=weight, mode="sum")

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        table, index, weight = ctx.saved_tensors
        to_table = to_weight = None
        if ctx.needs_input_grad[0]:
            rows = (weight[..., None] * gradient[:, None]).reshape(-1, table.shape[1])
            to_table = torch.zeros_like(table).index_add_(0, index.reshape(-1), rows)
        if ctx.needs_input_grad[2]:
            to_weight = (table[index] * gradient[:, None]).sum(-1)
        return to_table, None, to_weight
