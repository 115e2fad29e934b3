"""An uneven, textured body of four balls, seen by a ring of cameras: small enough to be drawn in the tests."""

import numpy as np
from io_scenes import look_at

from exmesh_graph.io.cameras import intrinsics_from_fov
from exmesh_graph.io.checks.outlines import Outlines
from exmesh_graph.io.checks.readings import Cameras

BALLS = np.array([[0, 0, 0, 0.45], [0.55, 0.1, 0.25, 0.25], [-0.2, 0.5, -0.1, 0.22], [0.1, -0.3, 0.6, 0.2]])
WIDTH, HEIGHT = 96, 80


def cameras(count=14, width=WIDTH, height=HEIGHT):
    """Uneven heights and distances; names as cameras give them, which sort otherwise than they count."""
    poses = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        height_of = (0.2, 0.9, -0.5)[i % 3]
        eye = (2.6 + 0.2 * (i % 4)) * np.array([np.cos(angle), np.sin(angle), height_of]) + [0.1, 0, 0]
        poses.append(look_at(eye, np.array([0.1, 0.05, 0.1]), np.array([0, 0, 1.0])))
    k = intrinsics_from_fov(0.75, width, height)
    names = tuple(f"v{i + 1}" for i in range(count))
    return Cameras(names, np.repeat(k[None], count, axis=0), np.stack(poses), width, height)


def close_cameras(count=24, width=192, height=160):
    """An arc around the body above the ground, ten degrees apart, as photographs for matching are taken."""
    poses = []
    for i in range(count):
        angle = np.radians(10 * i)
        eye = (2.4 + 0.15 * (i % 3)) * np.array([np.cos(angle), np.sin(angle), 0.8 + 0.25 * (i % 2)])
        poses.append(look_at(eye, np.array([0.1, 0.05, -0.1]), np.array([0, 0, 1.0])))
    k = intrinsics_from_fov(0.75, width, height)
    return Cameras(
        tuple(f"v{i + 1}" for i in range(count)), np.repeat(k[None], count, 0), np.stack(poses), width, height
    )


def drawn(camera, view, gain=1.0, ground=False):
    """(rgb [H, W, 3] linear, alpha [H, W]) at pixel centres; the texture is fixed to the surface."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pose, k = camera.camera_to_world[view], camera.intrinsics[view]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(k).T @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    nearest = np.full(x.shape, np.inf)
    for ball in BALLS:
        to = pose[:3, 3] - ball[:3]
        b, c = rays @ to, to @ to - ball[3] ** 2
        inside = b * b - c
        at = np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0)), np.inf)
        nearest = np.minimum(nearest, at)
    if ground:
        with np.errstate(divide="ignore"):
            at = (-0.7 - pose[2, 3]) / rays[..., 2]
        nearest = np.minimum(nearest, np.where(at > 0, at, np.inf))
    alpha = np.isfinite(nearest).astype(np.float32)
    points = pose[:3, 3] + np.where(alpha > 0, nearest, 0)[..., None] * rays
    rng = np.random.default_rng(5)
    waves = sum(np.sin(points @ rng.normal(size=3) * f + rng.uniform(0, 6)) for f in (6, 9, 13, 17, 23, 29, 31, 37))
    tone = 0.35 + 0.08 * waves
    rgb = np.clip(np.stack([tone, 0.9 * tone, 0.8 * tone], axis=-1) * gain, 0.01, 1) * alpha[..., None]
    return rgb.astype(np.float32), alpha


def outlines(camera):
    return Outlines.of(np.stack([drawn(camera, view)[1] for view in range(len(camera.names))]) >= 0.5, camera)
