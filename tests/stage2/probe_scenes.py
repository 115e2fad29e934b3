"""Tiny scenes for the probe, rendered by the project's own renderer: a ball or an open box, matte or of metal."""

from __future__ import annotations

import dataclasses

import numpy as np

from exmesh_graph.shading import envmap
from exmesh_graph.stage2.render import render_transport, render_views
from exmesh_graph.testing import look_at
from exmesh_graph.types import Asset, Carrier, Views

SIZE, TEXELS = 48, 64


def ball(count: int = 12):
    """Lat-long ball of radius 0.8 with per-corner UVs: vertices, faces, uvs [3F, 2]."""
    n = 2 * count
    t, p = np.meshgrid(np.pi * np.arange(count + 1) / count, 2 * np.pi * np.arange(n) / n, indexing="ij")
    grid = 0.8 * np.stack([np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)], -1).reshape(-1, 3)
    faces, uvs = [], []
    for i in range(count):
        for j in range(n):
            for cell in ([(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]):
                corner = [a * n + b % n if 0 < a < count else (0 if a == 0 else count * n) for a, b in cell]
                if len(set(corner)) == 3:
                    faces.append(corner)
                    uvs += [[0.03 + 0.94 * b / n, 0.03 + 0.94 * (1 - a / count)] for a, b in cell]
    used, faces = np.unique(faces, return_inverse=True)
    return grid[used], faces.reshape(-1, 3), np.array(uvs)


def box(cells: int = 8):
    """The inside of a cube of side 1.2 without its lid, each wall cut into cells; five charts."""
    vertices, faces, uvs = [], [], []
    line = np.linspace(-0.6, 0.6, cells + 1)
    a, b = np.meshgrid(line, line, indexing="ij")
    low = np.full_like(a, -0.6)
    walls = [(a, low, b), (low, b, a), (-low, a, b), (b, a, low), (a, b, -low)]
    for k, wall in enumerate(walls):
        first = len(vertices) * (cells + 1) ** 2
        vertices.append(np.stack(wall, -1).reshape(-1, 3))
        for i in range(cells):
            for j in range(cells):
                q = [first + u * (cells + 1) + v for u, v in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))]
                faces += [[q[0], q[2], q[1]], [q[0], q[3], q[2]]]
                corner = [(i, j), (i + 1, j + 1), (i + 1, j), (i, j), (i, j + 1), (i + 1, j + 1)]
                uvs += [
                    [(k % 3 + 0.06 + 0.88 * u / cells) / 3, (k // 3 + 0.06 + 0.88 * v / cells) / 2] for u, v in corner
                ]
    return np.concatenate(vertices), np.array(faces), np.array(uvs)


def die(cells: int = 3):
    """The outside of a cube of side 1.1, each wall cut into cells: six charts."""
    vertices, faces, uvs = [], [], []
    line = np.linspace(-0.55, 0.55, cells + 1)
    a, b = np.meshgrid(line, line, indexing="ij")
    high = np.full_like(a, 0.55)
    walls = [(high, a, b), (b, high, a), (a, b, high), (-high, b, a), (a, -high, b), (b, a, -high)]
    for k, wall in enumerate(walls):
        first = k * (cells + 1) ** 2
        vertices.append(np.stack(wall, -1).reshape(-1, 3))
        for i in range(cells):
            for j in range(cells):
                near = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                q = [first + u * (cells + 1) + v for u, v in near]
                faces += [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
                corner = [near[c] for c in (0, 1, 2, 0, 2, 3)]
                uvs += [
                    [(k % 3 + 0.06 + 0.88 * u / cells) / 3, (k // 3 + 0.06 + 0.88 * v / cells) / 2] for u, v in corner
                ]
    return np.concatenate(vertices), np.array(faces), np.array(uvs)


def plaster_die() -> Asset:
    """A die of one matt colour between a low warm sun and a blue sky."""
    truth = asset(die(), roughness=0.9)
    d = envmap.texel_directions(16, 32)
    sky = 0.5 * np.clip(0.6 + 0.4 * d[..., 1:2], 0.1, 1) * np.array([0.6, 0.8, 1.2])
    sky = sky + 6 * np.clip(d @ [0.7, 0.35, 0.6], 0, 1)[..., None] ** 20 * np.array([1.5, 1.0, 0.55])
    color = np.broadcast_to(np.float32([0.58, 0.5, 0.42]), truth.base_color.shape).copy()
    return dataclasses.replace(truth, base_color=color, environment=sky.astype(np.float32))


def asset(shape, *, metallic: float | None = None, roughness: float = 0.5, bright: float = 0.6) -> Asset:
    """A shape in smooth colours under a sky with a bright, warm side."""
    vertices, faces, uvs = shape
    v, u = np.meshgrid(*[(np.arange(TEXELS) + 0.5) / TEXELS] * 2, indexing="ij")
    color = np.stack(
        [bright + 0.25 * np.sin(9 * u), bright + 0.2 * np.cos(7 * v), bright - 0.1 + 0.2 * np.sin(5 * (u + v))], -1
    )
    d = envmap.texel_directions(16, 32)
    sky = 0.35 + 2.5 * np.clip(d @ [0.55, 0.65, 0.5], 0, 1)[..., None] ** 6 * np.array([1.3, 1.0, 0.7])
    sky = sky + 1.5 * np.clip(d @ [-0.8, 0.3, -0.5], 0, 1)[..., None] ** 12 * np.array([0.5, 0.8, 1.3])
    flat = np.ones((TEXELS, TEXELS), np.float32)
    return Asset(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        uvs=uvs.astype(np.float32),
        uv_faces=np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3),
        texture=np.full((TEXELS, TEXELS, 3), 0.5, np.float32),
        base_color=color.clip(0.02, 0.95).astype(np.float32),
        roughness=roughness * flat,
        metallic=None if metallic is None else metallic * flat,
        seen=np.ones((TEXELS, TEXELS), bool),
        environment=sky.astype(np.float32),
    )


def glazed_ball() -> Asset:
    """A dark, smooth ball in a dark room with seven windows."""
    glaze = asset(ball(), roughness=0.12, bright=0.05)
    sky = np.full((32, 64, 3), 0.05, np.float32)
    for row, column in ((6, 5), (9, 20), (5, 33), (12, 44), (8, 57), (18, 12), (20, 38)):
        sky[row : row + 3, column : column + 4] = 6
    return dataclasses.replace(glaze, base_color=glaze.base_color * 0.2, environment=sky)


def carrier_of(truth: Asset) -> Carrier:
    return Carrier(**{f.name: getattr(truth, f.name) for f in dataclasses.fields(Carrier)})


def cameras(count: int, *, above: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Cameras on a spiral around the origin (or over it), looking there: intrinsics, camera_to_world."""
    poses = []
    for k in range(count):
        height = 0.35 + 0.55 * (k + 0.5) / count if above else 0.95 - 1.9 * (k + 0.5) / count
        angle = 2.4 * k
        side = np.sqrt(1 - height * height)
        eye = 2.6 * np.array([side * np.sin(angle), height, side * np.cos(angle)])
        poses.append(look_at(eye))
    intrinsics = np.array([[1.15 * SIZE, 0, SIZE / 2], [0, 1.15 * SIZE, SIZE / 2], [0, 0, 1]])
    return np.repeat(intrinsics[None], count, 0), np.stack(poses)


def photographed(truth: Asset, count: int = 14, *, above: bool = False, bounces: int = 3) -> Views:
    """Training views of `truth`."""
    intrinsics, poses = cameras(count, above=above)
    light = render_transport(truth, bounces, directions=256, points=1500)
    shown = render_views(truth, intrinsics, poses, SIZE, SIZE, transport=light, specular_samples=16)
    return Views(
        names=tuple(f"v{k:02d}" for k in range(count)),
        images=shown.images,
        alpha=shown.alpha,
        intrinsics=intrinsics,
        camera_to_world=poses,
        split="train",
        clipped=False,
    )
