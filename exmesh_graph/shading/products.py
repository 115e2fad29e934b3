"""Products of the light transport's operators with colours: torch's, and on a CPU kernels that all cores share.

Float32 of three colours on a CPU takes the kernels (`kernels_products`), everything else torch. torch's own products of
these shapes are far from the memory's speed, and its sparse one has threads of its own, which wait for one another.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
import torch.nn.functional as F

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.warp_runtime import warp


def dense_product(transfer: torch.Tensor, radiance: torch.Tensor) -> torch.Tensor:
    """T L, [P, C] from T [P, K], stored by directions, and L [K, C]."""
    columns = transfer.t()
    if not _fused(columns, radiance):
        return (radiance.t() @ columns).t().contiguous()
    lights, points = columns.shape
    out = torch.empty(points, 3)
    split(_kernels().direct, _blocks(points), points, lights, columns, radiance.contiguous(), out, grain=1)
    return out


def dense_adjoint(transfer: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """T^T g, [K, C] from T [P, K], stored by directions, and g [P, C]."""
    columns = transfer.t()
    if not _fused(columns, gradient):
        return F.linear(columns, gradient.t().contiguous())
    lights, points = columns.shape
    sums = torch.empty(_blocks(points), lights, 3, dtype=torch.float64)
    split(_kernels().direct_adjoint, len(sums), points, lights, columns, gradient.contiguous(), sums, grain=1)
    return sums.sum(0).float()


def sparse_product(matrix: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """M x, [R, C] from a CSR matrix [R, P] and x [P, C]."""
    start, column, weight = matrix.crow_indices(), matrix.col_indices(), matrix.values()
    if not (_fused(weight, values) and column.dtype == torch.int32):
        return matrix @ values
    out = torch.empty(len(matrix), 3)
    padded = F.pad(values, (0, 1))
    split(_kernels().sparse, _blocks(len(out)), len(out), start, column, weight, padded, out, grain=1)
    return out


def mix_frequencies(spectrum: torch.Tensor, matrices: torch.Tensor) -> torch.Tensor:
    """Complex64 [S, F, 3], out[s, f] = sum_r m[f, r, s] x[r, f], of x complex64 [R, F, 3] and m float32 [F, R, S]; CPU.
    R is at most 1024.

    torch's batched product (`specular.convolve`) is the plain form; its columns, six numbers, are too few for it.
    """
    frequencies, rows, results = matrices.shape
    # as torch's transform lays it down and reads it: frequencies last
    parts = torch.view_as_real(spectrum.transpose(1, 2).contiguous())
    out = torch.empty(results, 3, frequencies, 2)
    split(_kernels().mix_frequencies, frequencies, frequencies, rows, results, parts, matrices, out, grain=8)
    return torch.view_as_complex(out).transpose(1, 2)


def _fused(operator: torch.Tensor, values: torch.Tensor) -> bool:
    plain = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (operator, values))
    return plain and operator.is_contiguous() and values.shape[1] == 3


def _blocks(points: int) -> int:
    return -(-points // int(_kernels().BLOCK))


@cache
def _kernels() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.shading import kernels_products

    return kernels_products
