"""Where planar Gaussians begin: points from structure from motion, in the visual hull, or at random."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.splat.gaussians import SH_DEGREE, Gaussians
from exmesh_graph.targets import Targets

_OPACITY = 0.1
_Y0 = 0.28209479177387814
_FLAT = 0.2


def gaussians_at(
    points: np.ndarray, colours: np.ndarray, normals: np.ndarray | None = None, *, seed: int = 0
) -> Gaussians:
    """Gaussians of opacity 0.1, as large as the mean distance to the three nearest points, in display colour [P, 3].

    Turned at random, or, with `normals` [P, 3], flat and square to these (zeros: at random). DataError for no points.
    """
    points = np.asarray(points, np.float32)
    if len(points) == 0:
        raise DataError("there are no points to start from", where="init.pgsr", expected="at least one point",
                        fix="start: hull with masks, or start: random")  # fmt: skip
    near = cKDTree(points).query(points, k=min(4, len(points)))[0].reshape(len(points), -1)[:, 1:]
    size = near.mean(1) if near.shape[1] else np.full(len(points), 0.05)
    size = np.clip(size, 1e-4, 0.1)
    generator = np.random.default_rng(seed)
    rotations = generator.normal(size=(len(points), 4))
    scales = np.repeat(np.log(size)[:, None], 3, 1)
    if normals is not None:
        known = np.linalg.norm(normals, axis=1) > 0
        half = normals[known] + [0.0, 0.0, 1 + 1e-6]  # half way between z and the normal: turns one into the other
        rotations[known] = np.concatenate([np.zeros((len(half), 1)), half], axis=1)
        scales[known, 2] += np.log(_FLAT)
    sh = np.zeros((len(points), (SH_DEGREE + 1) ** 2, 3))
    sh[:, 0] = (np.asarray(colours) - 0.5) / _Y0
    opacities = np.full(len(points), np.log(_OPACITY / (1 - _OPACITY)))
    arrays = (points, scales, rotations, opacities, sh)
    return Gaussians(*(torch.from_numpy(np.ascontiguousarray(a, np.float32)) for a in arrays))


def hull_points(
    field: SilhouetteField, count: int, *, inside: float = 0.5, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(points [P, 3], normals [P, 3]), `count` or one more, in the visual hull: a share `inside` of them all through
    its volume, where cavities may be (normal 0), the rest on its surface."""
    vertices, faces = visual_hull(field, resolution=64)
    generator = np.random.default_rng(seed)
    low, high = vertices.min(0), vertices.max(0)
    within = round(inside * count)
    tried = generator.uniform(low, high, (min(50 * within, 2_000_000), 3)).astype(np.float32)
    held = tried[field(tried, floor=-1e-6) > 0][:within]  # fewer where the hull is a thin sheet
    surface, face, _ = sample_surface(vertices, faces, max(count - len(held), 1), seed=seed)
    corners = vertices[faces[face]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.concatenate([surface, held]).astype(np.float32), np.concatenate([normals, np.zeros(held.shape)])


def random_points(count: int, *, radius: float = 1.0, seed: int = 0) -> np.ndarray:
    """float32 [count, 3], uniform in the ball around the origin."""
    generator = np.random.default_rng(seed)
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return (radius * direction * generator.uniform(size=(count, 1)) ** (1 / 3)).astype(np.float32)


@torch.no_grad()
def mean_colours(points: np.ndarray, targets: Targets, normals: np.ndarray | None = None) -> np.ndarray:
    """Display colour [P, 3]: the mean over the views whose photographs hold the point, and that its normal faces.

    Grey where there is none. What hides what is not asked: these are first values.
    """
    total, count = np.zeros((len(points), 3)), np.zeros((len(points), 1))
    for view in range(len(targets)):
        pose = targets.world_to_camera[view].cpu().numpy()
        camera = points @ pose[:3, :3].T + pose[:3, 3]
        depth = np.maximum(camera[:, 2:], 1e-6)
        place = (camera / depth) @ targets.intrinsics[view].cpu().numpy().T
        column, row = np.floor(place[:, 0]).astype(int), np.floor(place[:, 1]).astype(int)
        held = (camera[:, 2] > 1e-3) & (column >= 0) & (column < targets.width) & (row >= 0) & (row < targets.height)
        column, row = np.where(held, column, 0), np.where(held, row, 0)
        weight = (held * targets.alpha[view].cpu().numpy()[row, column] > 0.9).astype(float)
        if normals is not None:
            away = (normals @ pose[:3, :3].T * camera).sum(1) / np.linalg.norm(camera, axis=1).clip(1e-9)
            weight *= away < np.where(np.linalg.norm(normals, axis=1) > 0, -0.3, 1.0)
        total += weight[:, None] * targets.images[view].cpu().numpy()[row, column]
        count[:, 0] += weight
    return np.where(count > 0, total / np.maximum(count, 1), 0.5)
