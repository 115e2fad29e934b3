"""Photographs of a wavy painted wall with known depth, and cameras a few degrees apart."""

import numpy as np

from exmesh_graph.types import DepthMaps, Views

PAINT = np.random.default_rng(7).uniform(4, 30, (24, 3)), np.random.default_rng(8).uniform(0, 6, 24)


def paint(points: np.ndarray, detail: float = 1.0) -> np.ndarray:
    """Grey [...] in [0.2, 0.8] from points [..., 3]: waves in all directions; detail 0 is one flat grey."""
    waves = np.sin(np.einsum("...c,kc->...k", points, PAINT[0]) + PAINT[1]).mean(-1)
    return 0.5 + 0.9 * detail * np.clip(waves, -0.33, 0.33)


def wall(count: int = 5, size: int = 64, flat_half: bool = False) -> tuple[Views, DepthMaps]:
    """The plane x - 0.3 y + 0.2 - z = 0 turned to cameras on an arc, 8 degrees apart and 2.5 from the origin."""
    normal, offset = np.array([0.25, -0.3, -1.0]), -0.1
    k = np.array([[1.7 * size, 0, size / 2 + 0.7], [0, 1.7 * size, size / 2 - 1.2], [0, 0, 1]])
    poses, images, depths = [], [], []
    for i in range(count):
        angle = np.radians(8) * (i - count // 2)
        forward = np.array([np.sin(angle), 0.1 * np.sin(2.3 * i), np.cos(angle)])
        forward /= np.linalg.norm(forward)
        right = np.cross([0, 1.0, 0], forward)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = -2.5 * forward
        rows, columns = np.indices((size, size)) + 0.5
        rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(k).T @ pose[:3, :3].T
        depth = (offset - pose[:3, 3] @ normal) / (rays @ normal)
        points = pose[:3, 3] + depth[..., None] * rays
        shade = paint(points)
        if flat_half:
            shade = np.where(points[..., 0] < 0, 0.5, shade)
        poses.append(pose)
        images.append(np.repeat((shade**2.2)[..., None], 3, -1))
        depths.append(depth)
    names = tuple(f"w{i}" for i in range(count))
    views = Views(
        names, np.stack(images).astype(np.float32), np.ones((count, size, size), np.float32),
        np.repeat(k[None], count, 0), np.stack(poses), "train", has_masks=False,
    )  # fmt: skip
    return views, DepthMaps(names, np.stack(depths).astype(np.float32))
