"""Small scenes whose light is known."""

from __future__ import annotations

import numpy as np
import torch

from benchmarks.meshes import grid
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.shading.monte_carlo import Material, MeshSurface, Points


def bowl(rings: int = 24, inward: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """The lower half of the unit sphere; every point of it sees the opening under exactly half its cosine."""
    columns = 2 * rings
    polar, around = np.meshgrid(
        np.linspace(np.pi / 2, np.pi, rings + 1), np.linspace(0, 2 * np.pi, columns, endpoint=False), indexing="ij"
    )
    sine = np.sin(polar)
    vertices = np.stack([sine * np.sin(around), np.cos(polar), sine * np.cos(around)], -1).reshape(-1, 3)
    i, j = (axis.reshape(-1) for axis in np.meshgrid(np.arange(rings), np.arange(columns), indexing="ij"))
    a, b = i * columns + j, i * columns + (j + 1) % columns
    outward = np.concatenate([np.stack([a, a + columns, b], 1), np.stack([b, a + columns, b + columns], 1)])
    outward = outward[np.repeat(i[None], 2, 0).reshape(-1) < rings - 1]  # the last ring's quads are flat at the pole
    last = (rings - 1) * columns
    pole = len(vertices)
    cap = np.stack([last + np.arange(columns), np.full(columns, pole), last + (np.arange(columns) + 1) % columns], 1)
    faces = np.concatenate([outward, cap]).astype(np.int32)
    vertices = np.concatenate([vertices, [[0.0, -1.0, 0.0]]]).astype(np.float32)
    return vertices, faces[:, ::-1].copy() if inward else faces


def wall_and_floor() -> tuple[np.ndarray, np.ndarray]:
    """The unit square y = 0 facing up, and above its edge z = 0 a unit wall facing +Z."""
    floor, faces = grid(1, 1)
    wall = floor[:, [0, 2, 1]]
    return np.concatenate([floor, wall]).astype(np.float32), np.concatenate([faces, faces[:, ::-1] + 4])


def on_mesh(vertices, faces, count, seed=0, view=None):
    """`count` random points with flat normals, seen from random sides: (Points, face, bary)."""
    rng = torch.Generator().manual_seed(seed)
    surface = MeshSurface(vertices, faces)
    face = torch.randint(0, len(faces), (count,), generator=rng)
    bary = torch.rand(count, 3, generator=rng) + 0.05
    bary = bary / bary.sum(1, keepdim=True)
    flat = surface.face_normals[face]
    eye = flat + 0.7 * (torch.rand(count, 3, generator=rng) - 0.5) if view is None else view
    eye = torch.nn.functional.normalize(eye, dim=-1)
    return Points(surface.at(face, bary), flat, flat, eye), face, bary


def material(count, seed=0, dtype=torch.float32):
    rng = torch.Generator().manual_seed(seed)
    return Material(
        torch.rand(count, 3, generator=rng, dtype=dtype),
        (0.15 + 0.8 * torch.rand(count, generator=rng)).to(dtype),
        torch.rand(count, generator=rng, dtype=dtype),
    )


def studio(height=16, seed=0, dtype=torch.float32):
    """A smooth sky with a bright patch."""
    rng = torch.Generator().manual_seed(seed)
    sky = 0.2 + torch.rand(height, 2 * height, 3, generator=rng, dtype=dtype)
    sky[height // 4, height // 2] = 20
    return sky


def tracer_of(mesh):
    return make_ray_tracer(*mesh, "cpu")
