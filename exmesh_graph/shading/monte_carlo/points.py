"""What Monte Carlo light is computed for: surface points and their material; half resolution of an image's points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
import torch

from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.specular import scattered


@dataclass(frozen=True)
class Points:
    """N surface points; [N, 3], world space, unit vectors.

    flat    geometric normal, on the side the rays leave to
    normal  shading normal; where it looks away from a glossy point's viewer the light is 0
    view    towards the eye
    """

    position: torch.Tensor
    flat: torch.Tensor
    normal: torch.Tensor
    view: torch.Tensor

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, rows: slice | torch.Tensor) -> Points:
        return Points(self.position[rows], self.flat[rows], self.normal[rows], self.view[rows])


@dataclass(frozen=True)
class Material:
    """base_color [N, 3], linear; roughness [N] (None: no specular lobe); metallic [N] (None: dielectric)."""

    base_color: torch.Tensor
    roughness: torch.Tensor | None = None
    metallic: torch.Tensor | None = None

    def __getitem__(self, rows: slice | torch.Tensor) -> Material:
        parts = (self.base_color, self.roughness, self.metallic)
        return Material(*(None if part is None else part[rows] for part in parts))  # type: ignore[arg-type]

    def diffuse(self) -> torch.Tensor:
        """pi f_d = (1 - m) a, [N, 3]."""
        return self.base_color if self.metallic is None else self.base_color * (1 - self.metallic[:, None])

    def sent(self) -> torch.Tensor:
        """pi f [N, 3] of what a hit sends on, to all sides alike: diffuse, and lobes where there is a roughness."""
        if self.roughness is None:
            return self.diffuse()
        return math.pi * scattered(self.base_color, self.roughness, self.metallic)


#: (face int64 [M], bary [M, 3]) -> the shading normal [M, 3] and the material there: the paper's attribute query.
Query = Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, Material]]


class Surface(Protocol):
    """The frozen mesh as tensors: vertices [V, 3], faces int64 [F, 3], unit face_normals [F, 3]."""

    vertices: torch.Tensor
    faces: torch.Tensor
    face_normals: torch.Tensor


class MeshSurface:
    """A Surface from arrays: vertices [V, 3], faces [F, 3]."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, device: torch.device | str = "cpu") -> None:
        self.vertices = tensor_of(np.asarray(vertices, np.float32)).to(device)
        self.faces = tensor_of(np.asarray(faces, np.int64)).to(device)
        self.face_normals = torch.from_numpy(face_normals(vertices, faces).astype(np.float32)).to(device)

    def at(self, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        """Positions [N, 3] of faces int64 [N] at barycentric coordinates [N, 3]."""
        return mixed(self.vertices, self.faces, face, bary)


def mixed(rows: torch.Tensor, corners: torch.Tensor, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
    """[N, C]: rows [R, C] of the corners [F, 3] of faces int64 [N], at barycentric coordinates [N, 3]."""
    first, second, third = corners[face].unbind(-1)
    return rows[first] * bary[:, :1] + rows[second] * bary[:, 1:2] + rows[third] * bary[:, 2:]


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
    weight = (_weigh if points.position.dtype == torch.float32 else _plain_weights)(
        points, pixel, width, rows[index], there
    )
    weight[:, 0] += 1e-12
    return Coarse(rows, index, weight / weight.sum(1, keepdim=True))


@torch.no_grad()
def _weigh(points: Points, pixel: torch.Tensor, width: int, near: torch.Tensor, there: torch.Tensor) -> torch.Tensor:
    """`_plain_weights` by a kernel, in float32."""
    weight = torch.empty(near.shape, dtype=torch.float32, device=near.device)
    if len(weight):
        shape = [t.detach().contiguous() for t in (points.position, points.flat, points.normal)]
        settings = (width, _SLOPE, float(_POWER), _LEAST)
        lists = (pixel, near.reshape(-1), there.reshape(-1), weight.view(-1))
        split(_kernels().weigh, len(weight), *settings, *shape, *lists, grain=1024)
    return weight


def _plain_weights(
    points: Points, pixel: torch.Tensor, width: int, near: torch.Tensor, there: torch.Tensor
) -> torch.Tensor:
    """[N, 4]: tent times likeness of the candidates `near` int64 [N, 4], 0 where none is `there`. The reference."""
    y, x = torch.div(pixel, width, rounding_mode="floor"), pixel % width
    tent = _tent(x[:, None] - x[near]) * _tent(y[:, None] - y[near])
    return torch.where(there, tent.to(points.position) * _likeness(points, near), 0.0)


def _tent(distance: torch.Tensor) -> torch.Tensor:
    return (1 - distance.abs() / 2).clamp_min(_LEAST)


def _likeness(points: Points, near: torch.Tensor) -> torch.Tensor:
    step = points.position[near] - points.position[:, None]
    length = step.norm(dim=-1)
    away = torch.maximum((step * points.flat[:, None]).sum(-1).abs(), (step * points.flat[near]).sum(-1).abs())
    slope = away / length.clamp_min(1e-20)
    cosine = (points.normal[:, None] * points.normal[near]).sum(-1).clamp_min(0)
    return torch.exp(-((slope / _SLOPE) ** 2)) * cosine**_POWER


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.shading.monte_carlo import kernels_points

    return kernels_points
