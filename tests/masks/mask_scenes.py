"""A speckled ball on a speckled table before a speckled wall, with its true depth and masks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.masks.last import Given
from exmesh_graph.masks.outlines import Small
from exmesh_graph.masks.plane import Plane
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.masks.table import Table
from exmesh_graph.raster import rasterize
from exmesh_graph.testing import look_at
from exmesh_graph.types import DepthMaps, Views

GROUND = -0.35
SIDE = 96


class Scene(NamedTuple):
    views: Views
    depths: DepthMaps
    masks: np.ndarray
    ball: tuple[np.ndarray, np.ndarray]


def scene(
    *, count: int = 8, size: int = 64, radius: float = 0.35, table: float = 0.85, at: float = 0.0, focal: float = 1.5
) -> Scene:
    """`count` views of `size` pixels from above; the ball's middle is `at` along x, the table `table` wide (0: none).

    The ball is reddish, the table bluish, the wall grey; each pixel has noise of its own.
    """
    vertices, faces = icosphere(3, radius)
    ball = (vertices + np.array([at, 0, 0], np.float32)).astype(np.float32), faces
    whole, wide = ball, disc(table)
    if table:
        whole = np.concatenate([ball[0], wide[0]]), np.concatenate([ball[1], wide[1] + len(ball[0])])
    turns = 2 * np.pi * np.arange(count) / count
    heights = np.radians(np.where(np.arange(count) % 2, 20, 40))
    eyes = 2.6 * np.stack([np.cos(heights) * np.sin(turns), np.sin(heights), np.cos(heights) * np.cos(turns)], axis=1)
    poses = np.stack([look_at(eye) for eye in eyes])
    k = np.repeat(np.array([[[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1]]]), count, axis=0)
    seen = rasterize(
        torch.from_numpy(whole[0]), torch.from_numpy(whole[1]), torch.from_numpy(k),
        torch.from_numpy(np.linalg.inv(poses)), size, size,
    )  # fmt: skip
    face = seen.face_id.numpy()
    masks = (face >= 0) & (face < len(ball[1]))
    colours = np.where(masks[..., None], [0.6, 0.1, 0.1], np.where((face >= 0)[..., None], [0.1, 0.2, 0.6], 0.3))
    speckles = np.random.default_rng(0).uniform(0.6, 1.4, (count, size, size, 1))
    images = (colours * speckles).clip(0, 1).astype(np.float32)
    names = tuple(f"v{i}" for i in range(count))
    views = Views(names, images, np.ones((count, size, size), np.float32), k, poses, "train", has_masks=False)
    return Scene(views, DepthMaps(names, seen.depth.numpy()), masks, ball)


def disc(radius: float, height: float = GROUND, sides: int = 32) -> tuple[np.ndarray, np.ndarray]:
    """A round table top that looks up: vertices float32 [V, 3], faces int32 [F, 3]."""
    turn = 2 * np.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.sin(turn), np.full(sides, height), radius * np.cos(turn)], axis=1)
    k = np.arange(sides)
    faces = np.stack([np.zeros(sides), 1 + k, 1 + (k + 1) % sides], axis=1)
    return np.vstack([[0, height, 0], rim]).astype(np.float32), faces.astype(np.int32)


def overlap_of(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((first & second).sum() / (first | second).sum())


def box(low, high):
    """A closed box: vertices float32 [8, 3], faces int32 [12, 3]."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return (np.asarray(low) + corners * (np.asarray(high) - low)).astype(np.float32), np.array(faces, np.int32)


def stood(parts, whole, heights):
    """16 views of red boxes, each before a wall of its own colour, from so many degrees above, in turns; depth is that
    of the box `whole` around them, if given: (what masks are mended by, true masks, masks of `whole`)."""
    made = [box(*part) for part in parts]
    vertices = np.concatenate([b[0] for b in made])
    true = vertices, np.concatenate([b[1] + 8 * k for k, b in enumerate(made)])
    filled = true if whole is None else box(*whole)
    count = 16
    turn, height = 2 * np.pi * np.arange(count) / count, np.radians(np.resize(heights, count))
    eyes = 2.6 * np.stack([np.cos(height) * np.sin(turn), np.sin(height), np.cos(height) * np.cos(turn)], 1)
    poses = np.stack([look_at(eye) for eye in eyes])
    k = np.repeat(np.array([[[2.0 * SIDE, 0, SIDE / 2], [0, 2.0 * SIDE, SIDE / 2], [0, 0, 1]]]), count, 0)
    cameras = torch.from_numpy(k), torch.from_numpy(np.linalg.inv(poses))
    one, other = (rasterize(*map(torch.from_numpy, mesh), *cameras, SIDE, SIDE) for mesh in (true, filled))
    masks, filling = (seen.face_id.numpy() >= 0 for seen in (one, other))
    rng = np.random.default_rng(1)
    walls = rng.uniform(0.1, 0.9, (count, 1, 1, 3)) * [0.3, 1, 1]
    images = np.where(masks[..., None], [0.5, 0.02, 0.02], walls) + rng.normal(0, 0.01, (*masks.shape, 3))
    names = tuple(f"v{i}" for i in range(count))
    views = Views(names, images.clip(0, 1).astype(np.float32), np.ones(masks.shape, np.float32), k, poses, "train",
                  has_masks=False)  # fmt: skip
    table = Table(Plane(np.array([0.0, 1.0, 0.0]), GROUND, 0.0), DepthMaps(names, other.depth.numpy()))
    cutting = CutSettings(band=2)
    given = Given(Small.of(views, cutting, table), np.ones(count, bool), filled[0], cutting)
    return given, masks, filling
