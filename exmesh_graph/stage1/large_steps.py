"""Large steps (Nicolet, Jacobson, Jakob 2021, "Large Steps in Inverse Rendering of Geometry"): vertices x are optimised
through u = (I + lambda L) x, with L the combinatorial Laplacian (degree on the diagonal, -1 per edge).

A gradient g in x is (I + lambda L)^-1 g in u, and a step d in u moves x by (I + lambda L)^-1 d: the filter acts twice,
and smooth motions are fast while noise is damped. Adam's second moment is the largest over all vertices ("uniform"), so
that the direction of the filtered gradient is kept. There is no term in the loss: a surface at rest is not pulled to be
smooth.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from exmesh_graph.errors import NumericsError
from exmesh_graph.params import Params, param

if TYPE_CHECKING:  # the parameters are those of a node, which loads neither before it runs
    import numpy as np
    import torch

    from exmesh_graph.raster import EdgeTable
    from exmesh_graph.stage1.regularise import PreparedSmoothness

_TOLERANCE = 1e-5
_MOST_STEPS = 400


class LargeSteps(Params):
    """The filter (I + strength L)^-1, which reaches about sqrt(strength) edges far; a `regularise.Smoothness`."""

    strength: float = param(19.0, ge=0, doc="lambda of the paper; the filter reaches about its root, in edges.")

    def prepare(self, vertices: torch.Tensor, table: EdgeTable, pixels: float) -> PreparedSmoothness | None:
        from exmesh_graph.stage1.regularise import PreparedSmoothness

        return PreparedSmoothness(
            None, implicit_filter(len(vertices), table.edges, self.strength, vertices.device), uniform=True
        )


def implicit_filter(
    count: int, edges: torch.Tensor, strength: float, device: torch.device | str = "cpu"
) -> Callable[[torch.Tensor], torch.Tensor]:
    """x -> (I + strength L)^-1 x for [count, C], L over the undirected `edges` [E, 2] (each counted once).

    On a CPU a sparse LU decomposition (SuperLU) made once here; on other devices conjugate gradients.
    """
    import torch

    from exmesh_graph.stage1.regularise import distinct

    edges = distinct(edges.sort(dim=1).values, count)
    if torch.device(device).type == "cpu":
        return _factorised(count, edges.numpy(), strength)
    return _conjugate_gradients(count, edges.to(device), strength)


def _factorised(count: int, edges: np.ndarray, strength: float) -> Callable[[torch.Tensor], torch.Tensor]:
    import numpy as np
    import torch
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
    import torch

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
