"""Smoothness of the surface (L_s) and of its deformation (L_b), in forms that do not depend on the scene's scale.

With U v = mean of v's neighbours - v, l the mean edge length and V vertices:

    laplacian    1/V sum |U v|^2 / l^2              the paper's L_s, made scale-free
    bilaplacian  1/V sum |U U v|^2 / l^2            keeps curvature: flat is not preferred to round
    deviation    1/E sum over edges |D_i - D_j|^2 / l^2,  D = v - v_ref     the paper's L_b

Doubling the resolution of the same surface quarters |U v| and halves l: the Laplacian term then falls by four, as a
regulariser of noise should.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import torch

from exmesh_graph.raster import EdgeTable
from exmesh_graph.stage1.vertices import Neighbours, neighbours, serves, unevenness

Kind = Literal["laplacian", "bilaplacian"]
REFERENCE_DECAY = 0.99


class Smoothness(Protocol):
    """What `refine` takes as its L_s: made once for every call, hence for every topology."""

    def prepare(self, vertices: torch.Tensor, table: EdgeTable, pixels: float) -> PreparedSmoothness | None:
        """Of the start's vertices [V, 3] and edges, of which the mean one spans `pixels` of the photographs; None where
        there is nothing to do."""


class PreparedSmoothness(NamedTuple):
    """A smoothness on one topology.

    loss    the weighted term of the vertices [V, 3], or None
    filter  symmetric positive map of [V, 3] that gradients pass before Adam and its steps after it (Adam then works
            on the filter's preimage of the vertices), or None
    uniform whether Adam's second moment is one for all vertices, the largest; then filtered gradients keep their
            direction
    """

    loss: Callable[[torch.Tensor], torch.Tensor] | None
    filter: Callable[[torch.Tensor], torch.Tensor] | None = None
    uniform: bool = False


def weighted(kind: Kind, weight: float, vertices: torch.Tensor, edges: torch.Tensor) -> PreparedSmoothness | None:
    """The term `weight` times L_s of the vertices' topology; None for weight 0."""
    if weight == 0:
        return None
    of = smoother(vertices, edges)
    return PreparedSmoothness(lambda moved: weight * smoothness(moved, of, kind))


def pulled(vertices: torch.Tensor, firmness: torch.Tensor) -> torch.Tensor:
    """The vertices [V, 3] as they are, each with `firmness` [V] times the gradient that comes back to them."""
    return _Pulled.apply(vertices, firmness)


class Smoother(NamedTuple):
    """What the regularisers need of a topology: sparse U and its transpose, the edges, l, and on a CPU each vertex's
    neighbours."""

    laplacian: torch.Tensor
    transposed: torch.Tensor
    edges: torch.Tensor
    mean_edge: float
    neighbours: Neighbours | None = None


def smoother(vertices: torch.Tensor, edges: torch.Tensor) -> Smoother:
    """U over the undirected `edges` [E, 2] (each neighbour counts once), and the mean edge length of `vertices`."""
    count = len(vertices)
    length = mean_edge(vertices, edges)
    edges = distinct(edges, count)
    ends = torch.cat([edges, edges.flip(1)])
    degree = torch.bincount(ends[:, 0], minlength=count)
    diagonal = torch.nonzero(degree)[:, 0]
    index = torch.cat([ends.T, diagonal.expand(2, -1)], dim=1)
    values = torch.cat([1 / degree[ends[:, 0]].to(vertices.dtype), -vertices.new_ones(len(diagonal))])
    size = (count, count)
    forward = torch.sparse_coo_tensor(index, values, size, check_invariants=True).coalesce()
    backward = torch.sparse_coo_tensor(index.flip(0), values, size, check_invariants=True).coalesce()
    beside = neighbours(count, edges) if serves(vertices) else None
    return Smoother(_csr(forward), _csr(backward), edges, length, beside)


def mean_edge(vertices: torch.Tensor, edges: torch.Tensor) -> float:
    """The mean length of the undirected `edges` [E, 2], each counted once; 1 without any."""
    edges = distinct(edges, len(vertices))
    length = (vertices[edges[:, 0]] - vertices[edges[:, 1]]).norm(dim=1)
    return float(length.mean()) if len(edges) else 1.0


def distinct(edges: torch.Tensor, count: int) -> torch.Tensor:
    """int64 [E, 2]: the rows of integer `edges` [N, 2] of `count` vertices, in their order, each once."""
    keys = torch.unique(edges[:, 0].long() * count + edges[:, 1])  # in a quarter of the time of unique rows
    return torch.stack([keys // max(count, 1), keys % max(count, 1)], dim=1)


def smoothness(vertices: torch.Tensor, of: Smoother, kind: Kind) -> torch.Tensor:
    """L_s, a scalar; 0 on a plane of even vertices away from its boundary."""
    scale = 1 / (max(len(vertices), 1) * of.mean_edge**2)
    if of.neighbours is not None and serves(vertices):
        return unevenness(vertices, of.neighbours, 2 if kind == "bilaplacian" else 1, scale)
    difference = _Multiply.apply(vertices, of.laplacian, of.transposed)
    if kind == "bilaplacian":
        difference = _Multiply.apply(difference, of.laplacian, of.transposed)
    return difference.square().sum() * scale


def deviation(vertices: torch.Tensor, reference: torch.Tensor, of: Smoother) -> torch.Tensor:
    """L_b: neighbours should move alike, measured from `reference` [V, 3] (a running mean of the vertices)."""
    moved = vertices - reference
    along = moved.index_select(0, of.edges[:, 0]) - moved.index_select(0, of.edges[:, 1])
    return along.square().sum() / (max(len(of.edges), 1) * of.mean_edge**2)


def _csr(matrix: torch.Tensor) -> torch.Tensor:
    import warnings

    with warnings.catch_warnings():
        # torch announces on the first CSR tensor that the layout is in beta
        warnings.filterwarnings("ignore", message=".*Sparse CSR.*")
        return matrix.to_sparse_csr()


class _Pulled(torch.autograd.Function):
    @staticmethod
    def forward(ctx, vertices, firmness):
        ctx.firmness = firmness
        return vertices.view_as(vertices)

    @staticmethod
    def backward(ctx, grad):
        return grad * ctx.firmness[:, None], None


class _Multiply(torch.autograd.Function):
    """A constant sparse matrix times a dense one, with the transpose at hand: autograd would build it every time."""

    @staticmethod
    def forward(ctx, x, matrix, transposed):
        ctx.transposed = transposed
        return matrix @ x

    @staticmethod
    def backward(ctx, grad):
        return ctx.transposed @ grad, None, None
