"""Irradiance of a frozen mesh as linear operators on the light: what types.Transport stands for.

With K equal-area directions w_k and a ray along each from every surface point p (types.Transport):

    T[p, k] = max(n_p . w_k, 0) where the sky is seen, else 0
    M[p, q] += max(n_p . w_k, 0) (4 pi / K) bary_q          where the ray meets the front of the mesh between points q
    L_k      radiance x solid angle of the environment nearest to w_k
    I_0 = T L,   I_i = I_0 + s M (rho * I_(i-1)),  i = 1..n,   rho = (1 - m) a / pi,   s = lambda_ind of eq. 20

Diffuse radiance of a point is rho I_n. Without secondary material (an ablation of the paper) the receiving point's
own rho stands in for that of the hits: I_i = I_0 + s rho * M I_(i-1). Both operators carry exact adjoints
(`irradiance` is differentiable in L and rho), so nothing is sampled while fitting.

The recursion begun from I_0 + r in place of I_0, with r what I_n - I_0 was in the step before (`Deeper`), ends where
I = I_0 + s M (rho * I) does: the light of all bounces, for the work of n, while maps and light move slowly. The
gradient is that of the n bounces, r held. Where nothing is kept from step to step, the recursion goes on until r stays
(`Transport.deeper`).

Vector irradiance is how a point's irradiance changes when its shading normal turns:

    F(p) = sum_k V[p, k] L_k w_k        over the directions w_k above the point's horizon,  n . F = I_0

and the same over the blocked directions with what the mesh sends back along them.
"""

from __future__ import annotations

import copy
import math
from functools import cached_property

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import csr_tensor, tensor_of
from exmesh_graph.shading import envmap
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.lattice import locate
from exmesh_graph.shading.point_sets import nearest_direction
from exmesh_graph.shading.products import dense_adjoint, dense_product, sparse_product
from exmesh_graph.shading.transport import gathered_hits
from exmesh_graph.types import Transport

#: How far deeper bounces are followed where no fit does: until they change by so much of the brightest light, or the
#: recursion has been gone through so often.
SETTLED, MOST_ROUNDS = 1e-4, 32
#: What is beyond the direct light stays below so many times its brightest point: a closed room of albedo 0.95. Whiter
#: ones, or a quadrature that adds up to more than all directions, would send more with every step.
MOST_BEYOND = 20.0


class Deeper:
    """`rest` [P, 3]: what `irradiance` found beyond the direct light, kept from call to call; None before the first."""

    def __init__(self) -> None:
        self.rest: torch.Tensor | None = None


class LightTransport:
    """The operators T and M of a Transport as tensors, on `device`."""

    def __init__(self, light: Transport, device: torch.device | str = "cpu") -> None:
        self.light = light
        self.bounces = light.bounces
        self.directions = light.directions.astype(np.float64)
        self.visible = torch.from_numpy(
            np.unpackbits(light.visible, axis=1, count=len(light.directions), bitorder="little")
        ).to(device)
        cosine = torch.from_numpy(light.normals @ light.directions.T).to(device).clamp_min(0)
        # [P, K], but stored by directions: both products below then run along rows, four to nine times faster
        self.transfer = (cosine * self.visible).t().contiguous().t()
        self.gather = None
        if light.bounces and light.gather_start is not None:
            assert light.gather_point is not None
            assert light.gather_weight is not None
            shape = (len(light.points), len(light.points))
            self.gather = _csr(light.gather_start, light.gather_point, light.gather_weight, shape).to(device)

    @cached_property
    def gather_transposed(self) -> torch.Tensor:
        """M^T, which gradients need; CSR, as M is."""
        shape = (len(self.light.points), len(self.light.points))
        return _transposed(self.light, shape, self.transfer.device)

    def bin_matrix(self, height: int, width: int) -> torch.Tensor:
        """Sparse [K, H W]: takes a map's radiance to L_k, radiance x solid angle nearest to each direction.

        Texels wider than a direction's cell are cut into finer ones first; the sum over k is exact in energy.
        """
        fine = max(1, math.ceil(math.sqrt(16 * len(self.directions) / (height * width))))
        query = envmap.texel_directions(height * fine, width * fine).reshape(-1, 3)
        nearest = nearest_direction(query, self.directions)
        angle = np.repeat(envmap.solid_angles(height * fine, width * fine), width * fine)
        row = np.repeat(np.arange(height * fine) // fine, width * fine)
        column = np.tile(np.arange(width * fine) // fine, height * fine)
        matrix = torch.sparse_coo_tensor(
            torch.from_numpy(np.stack([nearest, row * width + column])),
            torch.from_numpy(angle.astype(np.float32)),
            (len(self.directions), height * width),
            check_invariants=False,
        )
        return matrix.coalesce().to(self.transfer.device)

    def irradiance(
        self,
        radiance: torch.Tensor,
        diffuse: torch.Tensor | None = None,
        strength: float = 1.0,
        deeper: Deeper | None = None,
    ) -> torch.Tensor:
        """I_n [P, 3] of binned light `radiance` L [K, 3] and f_d = `diffuse` [P, 3] at the points.

        `strength` is lambda_ind. Without bounces (or without `diffuse`) the direct light I_0. With `deeper` the bounces
        beyond the n-th are those of the last call with it, which this one replaces; a transport whose deeper bounces
        count finds them here otherwise.

        Equations: 18, 19.
        """
        if diffuse is None or self.gather is None or strength == 0:
            return _Direct.apply(radiance, self)
        if deeper is None and self.light.deeper:
            deeper = self._settled(radiance, diffuse, strength)
        return _Bounces.apply(radiance, diffuse, self, strength, deeper)

    @torch.no_grad()
    def _settled(self, radiance: torch.Tensor, diffuse: torch.Tensor, strength: float) -> Deeper:
        """What is beyond the direct light, once it changes by no more than SETTLED of the brightest."""
        deeper, before = Deeper(), None
        for _ in range(MOST_ROUNDS):
            found = _Bounces.apply(radiance, diffuse, self, strength, deeper)
            if before is not None and float((found - before).abs().max()) <= SETTLED * float(found.max()):
                break
            before = found
        return deeper

    def with_columns(self, transfer: torch.Tensor) -> LightTransport:
        """The same operators with further lights: T grows by the columns `transfer` [P, S], L by as many rows."""
        result = copy.copy(self)
        result.transfer = torch.cat([self.transfer.t(), transfer.t()]).t()
        return result

    def direct(self, radiance: torch.Tensor) -> torch.Tensor:
        """T L, [P, C] from [K, C]; no gradient.

        Equation: 12.
        """
        return dense_product(self.transfer, radiance)

    def direct_adjoint(self, gradient: torch.Tensor) -> torch.Tensor:
        """T^T g, [K, C] from [P, C]."""
        return dense_adjoint(self.transfer, gradient)


class Binning:
    """L_k of a map, by the matrix of `LightTransport.bin_matrix`; differentiable, by rows of the matrix both ways.

    torch's product takes ten times as long on the matrix as it comes, by coordinates.
    """

    def __init__(self, matrix: torch.Tensor) -> None:
        self.matrix, self.transposed = _by_rows(matrix), _by_rows(matrix.t())

    def __call__(self, environment: torch.Tensor) -> torch.Tensor:
        """Radiance x solid angle [K, 3] nearest to each direction, of `environment` [H, W, 3]."""
        return _Bin.apply(environment.reshape(-1, 3), self)


class VectorTransport:
    """The three components of T (and of M, where it has bounces) of `operators`, before the cosine."""

    def __init__(self, operators: LightTransport) -> None:
        light, device = operators.light, operators.transfer.device
        directions = tensor_of(light.directions).to(device)
        above = (tensor_of(light.normals).to(device) @ directions.T > 0) & (operators.visible > 0)
        # [P, 3, K]: K directions times their axes
        self.transfer = (above[:, None] * directions.T[None]).to(directions).reshape(-1, len(directions))
        self.gather = [_component(operators, axis) for axis in range(3)] if operators.gather is not None else []

    def vector(
        self, radiance: torch.Tensor, sent: torch.Tensor | None = None, received: torch.Tensor | None = None
    ) -> torch.Tensor:
        """F [P, 9] (x, y, z of red, green, blue: [3, 3] flattened) of binned light `radiance` [K, 3].

        sent      diffuse radiance [P, 3] of the points, which adds the mesh's own light; it gets no gradient. The
                  light does.
        received  [P, 3], what to multiply the mesh's own light with where it arrives; None: nothing
        """
        direct = (self.transfer @ radiance).reshape(-1, 9)
        if sent is None or not self.gather:
            return direct
        with torch.no_grad():
            arrived = torch.stack([sparse_product(matrix, sent.detach()) for matrix in self.gather], dim=1)
            if received is not None:
                arrived = arrived * received.detach()[:, None]
        return direct + arrived.reshape(-1, 9)


def at_surface(light: Transport, values: torch.Tensor, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
    """`values` [P, C] of the lattice points at surface positions, `face` int64 [N] and `bary` [N, 3]: [N, C]."""
    index, weight = locate(light, face.cpu().numpy(), bary.cpu().numpy())
    rows = torch.from_numpy(index.astype(np.int64)).to(values.device)
    return gather_rows(values, rows, torch.from_numpy(weight).to(values))


class _Bin(torch.autograd.Function):
    @staticmethod
    def forward(ctx, texels, binning):  # type: ignore[no-untyped-def]
        ctx.binning = binning
        return binning.matrix @ texels

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        return ctx.binning.transposed @ gradient, None


class _Direct(torch.autograd.Function):
    """I_0 = T L."""

    @staticmethod
    def forward(ctx, radiance, operators):  # type: ignore[no-untyped-def]
        ctx.operators = operators
        return operators.direct(radiance)

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        return ctx.operators.direct_adjoint(gradient), None


class _Bounces(torch.autograd.Function):
    """I_i = I_0 + s M (rho I_(i-1)), or I_0 + s rho M I_(i-1) without secondary material; the adjoint runs the
    recursion backwards through M^T and T^T."""

    @staticmethod
    def forward(ctx, radiance, diffuse, operators, strength, deeper):  # type: ignore[no-untyped-def]
        own = operators.light.secondary_material
        direct = operators.direct(radiance)
        states = [direct if deeper is None or deeper.rest is None else direct + deeper.rest]
        for _ in range(operators.bounces):
            sent = diffuse * states[-1] if own else states[-1]
            arrived = strength * sparse_product(operators.gather, sent)
            states.append(direct + (arrived if own else diffuse * arrived))
        if deeper is not None:
            deeper.rest = torch.minimum(states[-1] - direct, MOST_BEYOND * direct.amax(dim=0))
        ctx.operators, ctx.strength = operators, strength
        ctx.save_for_backward(diffuse, *states[:-1])
        return states[-1]

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        diffuse, *states = ctx.saved_tensors
        operators, own = ctx.operators, ctx.operators.light.secondary_material
        direct = torch.zeros_like(gradient)
        to_diffuse = torch.zeros_like(diffuse)
        adjoint = gradient
        for state in reversed(states):
            direct = direct + adjoint
            if own:
                back = ctx.strength * sparse_product(operators.gather_transposed, adjoint)
                to_diffuse = to_diffuse + back * state
                adjoint = back * diffuse
            else:
                to_diffuse = to_diffuse + adjoint * (ctx.strength * sparse_product(operators.gather, state))
                adjoint = ctx.strength * sparse_product(operators.gather_transposed, diffuse * adjoint)
        direct = direct + adjoint
        return operators.direct_adjoint(direct), to_diffuse, None, None, None


def _transposed(light: Transport, shape: tuple[int, int], device: torch.device | str) -> torch.Tensor:
    assert light.gather_start is not None
    assert light.gather_point is not None
    assert light.gather_weight is not None
    row = np.repeat(np.arange(shape[0]), np.diff(light.gather_start))
    order = np.lexsort((row, light.gather_point))
    start = np.concatenate([[0], np.cumsum(np.bincount(light.gather_point, minlength=shape[1]))])
    return _csr(start, row[order], light.gather_weight[order], shape).to(device)


def _component(operators: LightTransport, axis: int) -> torch.Tensor:
    """M before the cosine, times the axis' component of the direction; sparse [P, P]."""
    light = operators.light
    faces_up = (light.normals[light.hit_point] * light.directions[light.hit_direction]).sum(axis=1) > 0
    measure = light.directions[light.hit_direction, axis] * faces_up * (4 * math.pi / len(light.directions))
    count = len(light.points)
    return _csr(*gathered_hits(light, measure), (count, count)).to(operators.transfer.device)


def _csr(start: np.ndarray, column: np.ndarray, weight: np.ndarray, shape: tuple[int, int]) -> torch.Tensor:
    """A CSR matrix with 32-bit indices, which a Transport's own are."""
    wide = csr_tensor(start, column, weight, shape)
    indices = (wide.crow_indices().to(torch.int32), wide.col_indices().to(torch.int32))
    return torch.sparse_csr_tensor(*indices, wide.values(), shape, check_invariants=False)


def _by_rows(matrix: torch.Tensor) -> torch.Tensor:
    """A matrix by coordinates as CSR."""
    whole = matrix.coalesce()
    row, column = whole.indices().cpu().numpy()
    start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(matrix)))])
    shape = (matrix.shape[0], matrix.shape[1])
    return csr_tensor(start, column, whole.values().cpu().numpy(), shape).to(matrix.device)
