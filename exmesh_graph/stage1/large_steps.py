"""Large steps (Nicolet, Jacobson, Jakob 2021, "Large Steps in Inverse Rendering of Geometry"): vertices x are optimised
through u = (I + lambda L) x, with L the combinatorial Laplacian (degree on the diagonal, -1 per edge).

A gradient g in x is (I + lambda L)^-1 g in u, and a step d in u moves x by (I + lambda L)^-1 d: the filter acts twice,
and smooth motions are fast while noise is damped. Adam's second moment is the largest over all vertices ("uniform"), so
that the direction of the filtered gradient is kept. There is no term in the loss: a surface at rest is not pulled to be
smooth.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from exmesh_graph.errors import NumericsError

_TOLERANCE = 1e-5
_MOST_STEPS = 400


def implicit_filter(
    count: int, edges: torch.Tensor, strength: float, device: torch.device | str = "cpu"
) -> Callable[[torch.Tensor], torch.Tensor]:
    """x -> (I + strength L)^-1 x for [count, C], L over the undirected `edges` [E, 2] (each counted once).

    On a CPU a sparse LU decomposition (SuperLU) made once here; on other devices conjugate gradients.
    """
    edges = torch.unique(edges.long().sort(dim=1).values, dim=0)
    if torch.device(device).type == "cpu":
        return _factorised(count, edges.numpy(), strength)
    return _conjugate_gradients(count, edges.to(device), strength)


def _factorised(count: int, edges: np.ndarray, strength: float) -> Callable[[torch.Tensor], torch.Tensor]:
    from scipy.sparse import coo_matrix, identity
    from scipy.sparse.linalg import splu

    ends = np.concatenate([edges, edges[:, ::-1]])
    adjacency = coo_matrix((np.ones(len(ends)), ends.T), (count, count))
    degree = coo_matrix((np.asarray(adjacency.sum(1)).ravel(), (np.arange(count), np.arange(count))))
    matrix = (identity(count) + strength * (degree - adjacency)).tocsc()
    # symmetric positive definite: no pivoting is needed, and the ordering may be that of a Cholesky factor
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(x: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(solver.solve(x.detach().double().numpy())).to(x.dtype)

    return solve


def _conjugate_gradients(count: int, edges: torch.Tensor, strength: float) -> Callable[[torch.Tensor], torch.Tensor]:
    """Each column on its own, with the diagonal as preconditioner; to a relative residual of 1e-5."""
    i, j = edges.T
    degree = torch.bincount(edges.reshape(-1), minlength=count)

    def apply(x: torch.Tensor) -> torch.Tensor:
        difference = strength * (x[i] - x[j])
        return x.index_add(0, i, difference).index_add(0, j, -difference)

    def solve(x: torch.Tensor) -> torch.Tensor:
        inverse = (1 / (1 + strength * degree))[:, None].to(x.dtype)
        norm = x.norm(dim=0)
        solution = inverse * x
        residual = x - apply(solution)
        ready = inverse * residual
        along = ready
        power = (residual * ready).sum(0)
        for step in range(_MOST_STEPS):
            # asking costs a synchronisation
            if step % 8 == 0 and bool((residual.norm(dim=0) <= _TOLERANCE * norm).all()):
                return solution
            image = apply(along)
            length = power / (along * image).sum(0).clamp(min=torch.finfo(x.dtype).tiny)
            solution = solution + length * along
            residual = residual - length * image
            ready = inverse * residual
            before, power = power, (residual * ready).sum(0)
            along = ready + power / before.clamp(min=torch.finfo(x.dtype).tiny) * along
        raise NumericsError(
            f"{_MOST_STEPS} steps of conjugate gradients did not solve (I + {strength} L) u = x",
            where="regulariser.large_steps",
            fix="lower `strength`",
        )

    return solve
