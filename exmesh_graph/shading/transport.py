"""Diffuse light transport of a frozen mesh, traced once: irradiance is linear in the environment.

With K equal-area directions w_k and a ray along each from every surface point p (types.Transport):

    T[p, k] = max(n_p . w_k, 0) where the sky is seen, else 0
    M[p, q] += max(n_p . w_k, 0) (4 pi / K) bary_q          where the ray meets the front of the mesh between points q
    L_k      radiance x solid angle of the environment nearest to w_k
    I_0 = T L,   I_i = I_0 + s M (rho * I_(i-1)),  i = 1..n,   rho = (1 - m) a / pi,   s = lambda_ind of eq. 20

Diffuse radiance of a point is rho I_n. Without secondary material (an ablation of the paper) the receiving point's
own rho stands in for that of the hits: I_i = I_0 + s rho * M I_(i-1). Both operators carry exact adjoints
(`irradiance` is differentiable in L and rho), so nothing is sampled while fitting.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable

import numpy as np
import torch

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.gpu.torch_setup import csr_tensor
from exmesh_graph.rays import MISS, RayTracer, make_ray_tracer, offset_origins
from exmesh_graph.shading import envmap
from exmesh_graph.shading.directions import fibonacci_sphere, nearest_direction
from exmesh_graph.shading.lattice import Lattice, build_lattice, locate
from exmesh_graph.types import Transport

#: How far ray origins move from their lattice point towards the centre of the face that carries it: rays that start
#: exactly on a crease or in a corner meet the neighbouring face at distance zero.
INWARD = 0.02


def choose_subdivision(vertex_count: int, face_count: int, points: int) -> int:
    """The smallest subdivision whose lattice has at least `points` points (at most 16)."""
    edges = face_count * 3 // 2
    for n in range(1, 17):
        if vertex_count + edges * (n - 1) + face_count * (n - 1) * (n - 2) // 2 >= points:
            return n
    return 16


def trace_transport(
    vertices: np.ndarray,
    faces: np.ndarray,
    directions: int = 128,
    subdivision: int = 1,
    tracer: RayTracer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Transport:
    """Trace `directions` rays from every lattice point of the mesh; those below the point's horizon are left out.

    A direction above the shading normal's horizon but below the carrying face's own is blocked.
    """
    tracer = tracer or make_ray_tracer(vertices, faces)
    lattice = build_lattice(vertices, faces, subdivision)
    if directions > np.iinfo(np.uint16).max:
        raise GeometryError(f"{directions} directions", expected="at most 65535")
    sky = fibonacci_sphere(directions)
    flat = face_normals(vertices, faces)
    origins = lattice_origins(lattice, vertices, faces, tracer.radius)
    visible, hits = [], []
    chunk = max(1, (1 << 20) // directions)
    for start in range(0, len(origins), chunk):
        part = slice(start, start + chunk)
        free, hit = _trace_points(tracer, origins[part], lattice, flat, sky, start)
        visible.append(free)
        hits.append(hit)
        if progress:
            progress(min(start + chunk, len(origins)), len(origins))
    hit_point, hit_direction, hit_face, hit_bary = (np.concatenate(column) for column in zip(*hits, strict=True))
    return Transport(
        directions=sky.astype(np.float32),
        face_points=lattice.face_points,
        points=lattice.points.astype(np.float32),
        normals=lattice.normals.astype(np.float32),
        point_face=lattice.point_face,
        point_bary=lattice.point_bary.astype(np.float32),
        visible=np.concatenate(visible),
        hit_point=hit_point,
        hit_direction=hit_direction,
        hit_face=hit_face,
        hit_bary=hit_bary,
        subdivision=subdivision,
    )


def lattice_origins(light: Lattice | Transport, vertices: np.ndarray, faces: np.ndarray, radius: float) -> np.ndarray:
    """Where the rays of the lattice points start, float64 [P, 3]; `radius` is the tracer's."""
    carrying, corners = light.point_face, np.asarray(vertices, np.float64)[faces]
    inner = light.points + INWARD * (corners[carrying].mean(axis=1) - light.points)
    return offset_origins(inner, face_normals(vertices, faces)[carrying], radius)


def _trace_points(
    tracer: RayTracer, origins: np.ndarray, lattice: Lattice, flat: np.ndarray, sky: np.ndarray, start: int
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    part = slice(start, start + len(origins))
    above = (lattice.normals[part] @ sky.T > 0) & (flat[lattice.point_face[part]] @ sky.T > 0)
    point, direction = np.nonzero(above)
    hits = tracer.closest_hit(origins[point], sky[direction])
    free = np.zeros(above.shape, bool)
    free[point, direction] = hits.face == MISS
    front = (hits.face != MISS) & ((flat[hits.face] * sky[direction]).sum(axis=1) < 0)
    return np.packbits(free, axis=1, bitorder="little"), (
        (point[front] + start).astype(np.int32),
        direction[front].astype(np.uint16),
        hits.face[front],
        hits.bary[front, 1:],
    )


def with_bounces(light: Transport, bounces: int, secondary_material: bool = True) -> Transport:
    """`light` with the interreflection operator M built and `bounces` of it switched on.

    secondary_material  hits send their own colour; else the receiving point's colour stands in
    """
    cosine = (light.normals[light.hit_point] * light.directions[light.hit_direction]).sum(axis=1)
    measure = np.maximum(cosine, 0) * (4 * math.pi / len(light.directions))
    bary = np.concatenate([1 - light.hit_bary.sum(axis=1, keepdims=True), light.hit_bary], axis=1)
    column, weight = locate(light.face_points, light.subdivision, light.hit_face, bary)
    row = np.repeat(light.hit_point.astype(np.int64), 3)
    key = row * len(light.points) + column.reshape(-1)
    # rays of one point that meet the same lattice point share an entry
    unique, inverse = np.unique(key, return_inverse=True)
    value = np.bincount(inverse, weights=(weight * measure[:, None]).reshape(-1), minlength=len(unique))
    count = np.bincount(unique // len(light.points), minlength=len(light.points))
    return dataclasses.replace(
        light,
        bounces=bounces,
        secondary_material=secondary_material,
        gather_start=np.concatenate([[0], np.cumsum(count)]).astype(np.int32),
        gather_point=(unique % len(light.points)).astype(np.int32),
        gather_weight=value.astype(np.float32),
    )


def check_fits(light: Transport, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise GeometryError unless `light` was traced on this very mesh."""
    corners = light.subdivision
    local = [0, (corners + 1) * (corners + 2) // 2 - 1, corners]  # corner 0, corner 1 (i = n), corner 2 (j = n)
    same = len(light.face_points) == len(faces) and np.allclose(
        light.points[light.face_points[:, local]], vertices[faces], rtol=0, atol=1e-5
    )
    if not same:
        raise GeometryError(
            "the light transport was traced on another mesh than the one it is used with",
            expected=f"{len(faces)} faces with the same corners; it has {len(light.face_points)} faces",
            fix="wire the same output into transport.direct's `mesh` and stage2.fit's `carrier`",
        )


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
        self.gather = self.gather_transposed = None
        if light.bounces and light.gather_start is not None:
            assert light.gather_point is not None
            assert light.gather_weight is not None
            shape = (len(light.points), len(light.points))
            self.gather = _csr(light.gather_start, light.gather_point, light.gather_weight, shape, device)
            self.gather_transposed = _transposed(light, shape, device)

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
        self, radiance: torch.Tensor, diffuse: torch.Tensor | None = None, strength: float = 1.0
    ) -> torch.Tensor:
        """I_n [P, 3] of binned light `radiance` L [K, 3] and f_d = `diffuse` [P, 3] at the points.

        `strength` is lambda_ind. Without bounces (or without `diffuse`) the direct light I_0.

        Equations: 18, 20.
        """
        if diffuse is None or self.gather is None or strength == 0:
            return _Direct.apply(radiance, self)
        return _Bounces.apply(radiance, diffuse, self, strength)

    def with_columns(self, transfer: torch.Tensor) -> LightTransport:
        """The same operators with further lights: T grows by the columns `transfer` [P, S], L by as many rows."""
        result = copy.copy(self)
        result.transfer = torch.cat([self.transfer.t(), transfer.t()]).t()
        return result

    def direct(self, radiance: torch.Tensor) -> torch.Tensor:
        """T L, [P, C] from [K, C]; no gradient.

        Equation: 12.
        """
        return (radiance.t() @ self.transfer.t()).t().contiguous()

    def direct_adjoint(self, gradient: torch.Tensor) -> torch.Tensor:
        """T^T g, [K, C] from [P, C]."""
        return torch.nn.functional.linear(self.transfer.t(), gradient.t().contiguous())


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
    def forward(ctx, radiance, diffuse, operators, strength):  # type: ignore[no-untyped-def]
        own = operators.light.secondary_material
        direct = operators.direct(radiance)
        states = [direct]
        for _ in range(operators.bounces):
            sent = diffuse * states[-1] if own else states[-1]
            arrived = strength * (operators.gather @ sent)
            states.append(direct + (arrived if own else diffuse * arrived))
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
                back = ctx.strength * (operators.gather_transposed @ adjoint)
                to_diffuse = to_diffuse + back * state
                adjoint = back * diffuse
            else:
                to_diffuse = to_diffuse + adjoint * (ctx.strength * (operators.gather @ state))
                adjoint = ctx.strength * (operators.gather_transposed @ (diffuse * adjoint))
        direct = direct + adjoint
        return operators.direct_adjoint(direct), to_diffuse, None, None


def _csr(
    start: np.ndarray, index: np.ndarray, value: np.ndarray, shape: tuple[int, int], device: torch.device | str
) -> torch.Tensor:
    return csr_tensor(start, index, value, shape).to(device)


def _transposed(light: Transport, shape: tuple[int, int], device: torch.device | str) -> torch.Tensor:
    assert light.gather_start is not None
    assert light.gather_point is not None
    assert light.gather_weight is not None
    row = np.repeat(np.arange(shape[0]), np.diff(light.gather_start))
    order = np.lexsort((row, light.gather_point))
    start = np.concatenate([[0], np.cumsum(np.bincount(light.gather_point, minlength=shape[1]))])
    return _csr(start, row[order], light.gather_weight[order], shape, device)
