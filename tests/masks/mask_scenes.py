"""A speckled ball on a speckled table before a speckled wall, with its true depth and masks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.raster import rasterize
from exmesh_graph.testing import look_at
from exmesh_graph.types import DepthMaps, Views

GROUND = -0.35


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
