"""What `benchmarks.scale` measures: each function prepares a piece of work of a given size and returns it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

import numpy as np
import torch

from benchmarks.meshes import grid, torus
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.geometry.merge import merge
from exmesh_graph.geometry.settings import MergeSettings, SplitSettings
from exmesh_graph.geometry.split import split
from exmesh_graph.losses import d_ssim
from exmesh_graph.raster import antialias, edge_table, find_silhouette, project, rasterize, rasterize_projected, shade
from exmesh_graph.raster.rasterize import contribution_counts
from exmesh_graph.shading.transport import choose_steps, trace_transport
from exmesh_graph.uv.raster import dilate, rasterize_atlas
from exmesh_graph.uv.unwrap import unwrap

Work = Callable[[], object]
POINTS, DIRECTIONS = 12_000, 64


def ball(faces: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A closed torus of about that many faces before the camera, with a texture coordinate per vertex."""
    across = round(math.sqrt(faces / 2))
    vertices, triangles = torus(across, across)
    v = np.asarray(vertices, np.float32)
    uv = (v[:, :2] - v[:, :2].min(0)) / np.ptp(v[:, :2], axis=0)
    return torch.from_numpy(v), torch.from_numpy(np.asarray(triangles, np.int32)), torch.from_numpy(uv)


def sheet(faces: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A bumpy sheet of about that many faces with its plan as atlas: (vertices, faces, uvs, uv_faces)."""
    across = round(math.sqrt(faces / 2))
    vertices, triangles = grid(across, across)
    u, v = vertices[:, 0], 1 - vertices[:, 2]
    bumps = np.stack([vertices[:, 0], 0.05 * np.sin(9 * u) * np.cos(7 * v), vertices[:, 2]], axis=1)
    uvs = 0.01 + 0.98 * np.stack([u, v], axis=1)
    return bumps.astype(np.float32), triangles, uvs.astype(np.float32), triangles


def camera(size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """K and the pose that fill a picture of `size` with the torus."""
    pose = torch.eye(4)
    pose[2, 3] = 3.7
    return torch.tensor([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]]), pose


def rasterise(faces: int, size: int = 512) -> Work:
    vertices, triangles, _ = ball(faces)
    return lambda: rasterize(vertices, triangles, *camera(size), size, size)


def colour(faces: int, size: int, texels: int = 512) -> Work:
    """Textured, antialiased, with gradients to vertices and texels: what a step of Stage I draws."""
    vertices, triangles, uvs = ball(faces)
    table, texture = edge_table(triangles), torch.rand(texels, texels, 3).requires_grad_()
    weight = torch.rand(size, size, 4)

    def work() -> object:
        v = vertices.clone().requires_grad_()
        projected = project(v, *camera(size))
        seen = rasterize_projected(projected, triangles, size, size)
        rgb = shade(projected, triangles, uvs, triangles, texture, seen.face_id)
        layers = torch.cat([rgb, (seen.face_id >= 0).float()[..., None]], dim=-1)
        image = antialias(layers, projected, find_silhouette(projected, table, seen))
        return torch.autograd.grad(image, (v, texture), weight)

    return work


def splitting(faces: int) -> Work:
    mesh = sheet(faces)
    gradient = np.random.default_rng(0).random(len(mesh[0])).astype(np.float32)
    return lambda: split(*mesh, gradient, 4 * faces, SplitSettings(), max_rounds=1)


def merging(faces: int) -> Work:
    mesh = sheet(faces)
    rendered = (np.random.default_rng(0).random(len(mesh[1])) > 0.2).astype(np.int64)
    return lambda: merge(*mesh, rendered, MergeSettings(min_faces=4), max_rounds=1)


def unwrapping(faces: int) -> Work:
    vertices, triangles, _ = ball(faces)
    return lambda: unwrap(vertices.numpy(), triangles.numpy(), 1024)


def tracing(faces: int, directions: int = DIRECTIONS) -> Work:
    vertices, triangles = (part.numpy() for part in ball(faces)[:2])
    steps = choose_steps(vertices, triangles, POINTS)
    return lambda: trace_transport(vertices, triangles, directions, steps)


def ring(views: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(K float64 [views, 3, 3], world-to-camera [views, 4, 4]) of cameras around the unit sphere."""
    found = []
    for k in range(views):
        height = 0.8 * (2 * (k + 0.5) / views - 1)
        turn, level = 2.4 * k, math.sqrt(1 - height**2)
        back = np.array([level * math.cos(turn), height, level * math.sin(turn)])
        right = np.cross([0.0, 1.0, 0.0], back) / level
        rotation = np.stack([right, -np.cross(back, right), -back])
        found.append(np.block([[rotation, -rotation @ (3.7 * back)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    one = np.array([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1.0]])
    return np.tile(one, (views, 1, 1)), np.stack(found)


def carving(views: int, size: int = 96) -> Work:
    """The visual hull of a ball, from masks to mesh."""
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    mask = np.clip(0.27 * size - np.hypot(x, y) + 0.5, 0, 1).astype(np.float32)
    alpha, cameras = np.broadcast_to(mask, (views, size, size)), ring(views, size)
    return lambda: visual_hull(SilhouetteField.from_masks(alpha, *cameras), resolution=64)


def counting(views: int, size: int = 256) -> Work:
    """In how many views each of 20 000 faces is seen, which merging asks."""
    vertices, triangles = (part.numpy() for part in ball(20_000)[:2])
    intrinsics, poses = ring(views, size)
    towards_world = np.linalg.inv(poses)
    return lambda: contribution_counts(vertices, triangles, intrinsics, towards_world, size, size)


def similarity(pixels: int) -> Work:
    side = round(math.sqrt(pixels))
    image, target = torch.rand(side, side, 3).requires_grad_(), torch.rand(side, side, 3)
    return lambda: torch.autograd.grad(d_ssim(image, target), image)


def lighting(samples: int) -> Work:
    """Monte Carlo light with its gradient at 96 x 96 pixels."""
    from benchmarks import light_scene
    from benchmarks.light_curve import Bench, Choice

    options = argparse.Namespace(repeats=1, clock="cpu", threads=1, reference=1)
    bench = Bench(light_scene.build(96, metallic=True), options)
    return lambda: bench.step(Choice("mis", samples, 16, 4), 0)


def atlas_map(texels: int) -> Work:
    """Which face lies under each texel, 20 000 faces."""
    *_, uvs, uv_faces = sheet(20_000)
    return lambda: rasterize_atlas(uvs, uv_faces, round(math.sqrt(texels)), 1.5)


def spreading(texels: int) -> Work:
    """Fill what lies between charts: a third of the texels."""
    side = round(math.sqrt(texels))
    texture, mask = np.zeros((side, side, 3), np.float32), np.ones((side, side), bool)
    mask[:: max(1, side // 32)] = False
    mask[:, side // 3 :: 3] = False
    return lambda: dilate(texture, mask)


def optimising(texels: int) -> Work:
    """A step of Adam on the whole texture."""
    side = round(math.sqrt(texels))
    texture = torch.rand(side, side, 3).requires_grad_()
    texture.grad = torch.rand(side, side, 3)
    adam = torch.optim.Adam([texture], fused=True)
    return lambda: adam.step()
