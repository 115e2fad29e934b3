"""Matches against cameras: how far from their epipolar lines they lie, as the cameras are and as they may be meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exmesh_graph.io.checks.features import Pair
from exmesh_graph.io.checks.readings import Cameras

NEAR = 2.0  # pixels from its line that a match may lie
_STEP = 0.05
_PARALLEL = 3e-4  # squared sine of one degree


def off_lines(pair: Pair, cameras: Cameras, over: tuple[bool, bool] = (False, False)) -> np.ndarray:
    """Sampson distances [M] in pixels of a pair's matches (Hartley and Zisserman, eq. 11.9); inf behind a camera."""
    a, b = pair.first, pair.second
    size = np.array([cameras.width, cameras.height])
    places, others = (np.where(over, size - points, points) for points in (pair.places, pair.others))
    relative = np.linalg.inv(cameras.camera_to_world[b]) @ cameras.camera_to_world[a]
    rotation, t = relative[:3, :3], relative[:3, 3]
    inverse = [np.linalg.inv(cameras.intrinsics[view]) for view in (a, b)]
    across = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    fundamental = inverse[1].T @ across @ rotation @ inverse[0]
    x, y = (np.c_[points, np.ones(len(points))] for points in (places, others))
    lines, back = x @ fundamental.T, y @ fundamental
    value = (y * lines).sum(axis=1)
    slope = np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    distance = np.abs(value) / np.maximum(slope, 1e-12)
    return np.where(_in_front(x @ inverse[0].T, y @ inverse[1].T, rotation, t), distance, np.inf)


def agreeing(pairs: Sequence[Pair], cameras: Cameras, over: tuple[bool, bool] = (False, False)) -> np.ndarray:
    """Share [P] of each pair's matches that lie near their lines and in front of both cameras."""
    return np.array([float((off_lines(pair, cameras, over) < NEAR).mean()) for pair in pairs])


def possible(pair: Pair, seed: int = 0) -> float:
    """Share of a pair's matches that some pair of cameras would explain (fundamental matrix, RANSAC)."""
    from skimage.measure import ransac
    from skimage.transform import FundamentalMatrixTransform

    try:
        _, inliers = ransac(
            (pair.places, pair.others), FundamentalMatrixTransform, min_samples=8, residual_threshold=1.0,
            max_trials=150, rng=seed,
        )  # fmt: skip
    except ValueError:  # what scikit-image raises where no model has eight matches
        return 0.0
    return 0.0 if inliers is None else float(np.mean(inliers))


def _in_front(x: np.ndarray, y: np.ndarray, rotation: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Whether the point nearest to both rays lies in front of both cameras; so it does where they are parallel."""
    d, e = x @ rotation.T, y
    dd, ee, de = (d * d).sum(1), (e * e).sum(1), (d * e).sum(1)
    dt, et = d @ t, e @ t
    determinant = np.maximum(dd * ee - de**2, 1e-12)
    along, other = (-ee * dt + de * et) / determinant, (dd * et - de * dt) / determinant
    parallel = determinant < _PARALLEL * dd * ee
    return np.where(parallel, de > 0, (along > 0) & (other > 0))


@dataclass(frozen=True)
class Offset:
    """The shift of the principal point, alike in x and y, that matches ask for, and its standard error, in pixels."""

    best: float
    error: float
    matches: int


def principal_offset(pairs: Sequence[Pair], cameras: Cameras) -> Offset | None:
    """The offset by Gauss-Newton on Sampson distances under a Cauchy weight; None where fewer than 50 matches agree.

    The error is the sandwich estimate over pairs: matches of one pair share what is wrong with its cameras.
    """
    offset = 0.0
    for _ in range(8):
        rows = [_signed(pair, cameras, offset) for pair in pairs]
        total = sum(len(residual) for residual, _ in rows)
        if total < 50:
            return None
        every = np.concatenate([residual for residual, _ in rows])
        scale = max(1.48 * float(np.median(np.abs(every))), 1e-3)
        weights = [1 / (1 + (residual / (2 * scale)) ** 2) for residual, _ in rows]
        normal = sum(float((w * j * j).sum()) for w, (_, j) in zip(weights, rows, strict=True))
        scores = np.array([float((w * j * r).sum()) for w, (r, j) in zip(weights, rows, strict=True)])
        if normal <= 0:
            return None
        offset = float(np.clip(offset - scores.sum() / normal, -3, 3))
    return Offset(offset, float(np.sqrt((scores**2).sum())) / normal, total)


def _signed(pair: Pair, cameras: Cameras, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """(signed Sampson distances of the near matches at an offset, their derivatives by it)."""
    values = [_distance(pair, cameras, offset + step) for step in (-_STEP, 0.0, _STEP)]
    kept = np.abs(values[1]) < NEAR
    return values[1][kept], ((values[2] - values[0]) / (2 * _STEP))[kept]


def _distance(pair: Pair, cameras: Cameras, offset: float) -> np.ndarray:
    a, b = pair.first, pair.second
    relative = np.linalg.inv(cameras.camera_to_world[b]) @ cameras.camera_to_world[a]
    t = relative[:3, 3]
    across = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    k = cameras.intrinsics[[a, b]].copy()
    k[:, :2, 2] += offset
    fundamental = np.linalg.inv(k[1]).T @ across @ relative[:3, :3] @ np.linalg.inv(k[0])
    x, y = (np.c_[points, np.ones(len(points))] for points in (pair.places, pair.others))
    lines, back = x @ fundamental.T, y @ fundamental
    slope = np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    return np.asarray((y * lines).sum(axis=1) / np.maximum(slope, 1e-12))
