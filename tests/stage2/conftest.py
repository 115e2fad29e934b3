"""A small scene: a bumpy ball over a slab, textured, seen by eight cameras under a smooth sky."""

import dataclasses

import numpy as np
import pytest
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.testing import look_at
from exmesh_graph.types import Asset, Carrier, Views

SIZE = 40

torch.set_num_threads(1)  # the tensors are small: more threads only wait for one another


def _ball(count=14):
    """Lat-long ball with per-corner UVs in the left half of the atlas."""
    vertices, faces, uvs = [], [], []
    n = 2 * count
    index = {}
    for i in range(count + 1):
        for j in range(n):
            t, p = np.pi * i / count, 2 * np.pi * j / n
            key = (i, 0) if i in (0, count) else (i, j)
            if key not in index:
                index[key] = len(vertices)
                vertices.append([np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)])

    def vertex(i, j):
        return index[(i, 0) if i in (0, count) else (i, j % n)]

    def uv(i, j):
        return [0.02 + 0.6 * j / n, 0.04 + 0.92 * (1 - i / count)]

    for i in range(count):
        for j in range(n):
            for cell in ([(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]):
                corner = [vertex(*c) for c in cell]
                if len(set(corner)) == 3:
                    faces.append(corner)
                    uvs += [uv(*c) for c in cell]
    return 0.5 * np.array(vertices) + [0, 0.1, 0], np.array(faces), np.array(uvs)


def _slab():
    """A floor under the ball, facing up, cut into 6 x 6 cells; UVs in the right part of the atlas."""
    grid = np.linspace(-0.7, 0.7, 7)
    x, z = np.meshgrid(grid, grid, indexing="ij")
    vertices = np.stack([x, np.full_like(x, -0.45), z], -1).reshape(-1, 3)
    faces = []
    for i in range(6):
        for j in range(6):
            a, b, c, d = i * 7 + j, (i + 1) * 7 + j, (i + 1) * 7 + j + 1, i * 7 + j + 1
            faces += [[a, c, b], [a, d, c]]
    faces = np.array(faces)
    corner = vertices[faces].reshape(-1, 3)
    return (
        vertices,
        faces,
        np.stack([0.66 + 0.3 * (corner[:, 0] + 0.7) / 1.4, 0.1 + 0.3 * (corner[:, 2] + 0.7) / 1.4], 1),
    )


@pytest.fixture(scope="session")
def true_asset():
    """The scene's truth: smooth colours, roughness 0.35 / 0.6, a sky brighter and warmer on one side."""
    (v1, f1, t1), (v2, f2, t2) = _ball(), _slab()
    faces = np.concatenate([f1, f2 + len(v1)]).astype(np.int32)
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(64) + 0.5) / 64, indexing="ij")
    color = np.stack([0.5 + 0.3 * np.sin(9 * u), 0.45 + 0.25 * np.cos(7 * v), 0.3 + 0.2 * np.sin(5 * (u + v))], -1)
    d = envmap.texel_directions(16, 32)
    sky = 0.4 + 2.0 * np.clip(d @ [0.6, 0.6, 0.5], 0, 1)[..., None] ** 4 * np.array([1.3, 1.0, 0.7])
    return Asset(
        vertices=np.concatenate([v1, v2]).astype(np.float32),
        faces=faces,
        uvs=np.concatenate([t1, t2]).astype(np.float32),
        uv_faces=np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3),
        texture=np.full((64, 64, 3), 0.735357, np.float32),  # linear 0.5: fits start gray
        base_color=color.astype(np.float32),
        roughness=np.where(u > 0.64, 0.6, 0.35).astype(np.float32),
        seen=np.ones((64, 64), bool),
        environment=sky.astype(np.float32),
    )


@pytest.fixture(scope="session")
def cameras():
    """(intrinsics [9, 3, 3], camera_to_world [9, 4, 4]): a ring looking at the origin; the last is held out."""
    poses = []
    for k in range(9):
        angle, height = 2 * np.pi * k / 8 + (0.3 if k == 8 else 0), 0.35 + 0.25 * (k % 3)
        eye = np.array([np.sin(angle), height, np.cos(angle)]) * 2.4 / np.hypot(1, height)
        poses.append(look_at(eye))
    focal = 0.9 * SIZE
    intrinsics = np.array([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]])
    return np.repeat(intrinsics[None], 9, 0), np.stack(poses)


@pytest.fixture(scope="session")
def true_render(true_asset, cameras):
    from exmesh_graph.stage2.render import render_transport, render_views

    light = render_transport(true_asset, 2, directions=256, points=4000)
    return render_views(true_asset, *cameras, SIZE, SIZE, transport=light)


@pytest.fixture(scope="session")
def train_views(true_render, cameras):
    intrinsics, poses = cameras
    return Views(
        names=tuple(f"v{k}" for k in range(8)),
        images=true_render.images[:8],
        alpha=true_render.alpha[:8],
        intrinsics=intrinsics[:8],
        camera_to_world=poses[:8],
        split="train",
        clipped=False,
    )


@pytest.fixture(scope="session")
def carrier(true_asset):
    names = [f.name for f in dataclasses.fields(Carrier)]
    return Carrier(**{name: getattr(true_asset, name) for name in names})


@pytest.fixture(scope="session")
def transport(carrier):
    from exmesh_graph.shading.transport import trace_transport, with_bounces

    return with_bounces(trace_transport(carrier.vertices, carrier.faces, 128, steps=2), 1)
