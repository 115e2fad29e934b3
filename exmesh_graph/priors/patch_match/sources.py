"""Which views a view is compared with, and the maps between their pixels."""

from __future__ import annotations

import numpy as np

_PARALLAX = 15.0  # degrees between viewing directions: depth is sharp, and windows still look alike
_MOST_ANGLE = 50.0
_LEAST_SEEN = 0.25  # of a view's share of the scene that a source must show
_SAMPLES = 512


def scene_samples(points: np.ndarray | None) -> np.ndarray:
    """Where the scene may be, float64 [P, 3]: at most 512 of `points` inside the unit sphere, else points all over it.

    A spiral on shells of equal volume, the same at every call.
    """
    if points is not None:
        held = np.asarray(points, float)
        held = held[np.isfinite(held).all(axis=1)]
        held = held[np.linalg.norm(held, axis=1) < 1]
        if len(held) >= 16:
            return held[:: -(-len(held) // _SAMPLES)]
    index = np.arange(_SAMPLES) + 0.5
    height, turn = 1 - 2 * index / _SAMPLES, np.pi * (1 + np.sqrt(5)) * index
    around = np.sqrt(1 - height**2)
    radius = ((index * 0.618034) % 1) ** (1 / 3)
    return radius[:, None] * np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=1)


def choose_sources(
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    count: int,
    points: np.ndarray | None = None,
) -> np.ndarray:
    """int32 [N, count], the views to compare each view with, best first; -1 where there are no more.

    Those of which the angle between the rays to what both show is most nearly 15 degrees and at most 50, and that show
    at least a quarter of what the view shows of `points` (or of the unit sphere).
    """
    samples = scene_samples(points)
    poses = np.linalg.inv(camera_to_world)
    local = np.einsum("nij,pj->npi", poses[:, :3, :3], samples) + poses[:, None, :3, 3]
    image = np.einsum("nij,npj->npi", intrinsics, local)
    z = np.maximum(image[..., 2], 1e-9)
    x, y = image[..., 0] / z, image[..., 1] / z
    shown = (image[..., 2] > 0) & (x > 0) & (x < width) & (y > 0) & (y < height)
    rays = samples - camera_to_world[:, None, :3, 3]
    rays = rays / np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-12)
    chosen = np.full((len(poses), count), -1, np.int32)
    for view in range(len(poses)):
        both = shown & shown[view]
        seen = both.sum(axis=1) / max(shown[view].sum(), 1)
        cosine = np.clip((rays * rays[view]).sum(axis=2), -1, 1)
        middle = np.where(both, np.degrees(np.arccos(cosine)), 0).sum(axis=1) / np.maximum(both.sum(axis=1), 1)
        away = np.abs(np.log(np.maximum(middle, 1e-3) / _PARALLAX)) - np.log(np.maximum(seen, 1e-3))
        away[(middle > _MOST_ANGLE) | (seen < _LEAST_SEEN) | (middle < 0.5)] = np.inf
        away[view] = np.inf
        order = np.argsort(away, kind="stable")[:count]
        order = order[np.isfinite(away[order])]
        chosen[view, : len(order)] = order
    return chosen


def transfers(intrinsics: np.ndarray, world_to_camera: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """float32 [N, S, 24]: A (3 x 3) and b (3) of x' ~ A (x, y, 1) + b w to each source, and the same back.

    w is the inverse depth in the view the pixel is of. Rows of sources -1 are 0.
    """
    out = np.zeros((*chosen.shape, 24))
    inverse = np.linalg.inv(intrinsics)
    for view, slot in np.argwhere(chosen >= 0):
        other = chosen[view, slot]
        forth = world_to_camera[other] @ np.linalg.inv(world_to_camera[view])
        back = np.linalg.inv(forth)
        out[view, slot, :9] = (intrinsics[other] @ forth[:3, :3] @ inverse[view]).ravel()
        out[view, slot, 9:12] = intrinsics[other] @ forth[:3, 3]
        out[view, slot, 12:21] = (intrinsics[view] @ back[:3, :3] @ inverse[other]).ravel()
        out[view, slot, 21:] = intrinsics[view] @ back[:3, 3]
    return out.astype(np.float32)


def search_bounds(
    intrinsics: np.ndarray, world_to_camera: np.ndarray, chosen: np.ndarray, matrices: np.ndarray
) -> np.ndarray:
    """float32 [N, 4] of each view: least and most inverse depth (the unit sphere's), the change of inverse depth that
    moves the middle of the scene by a pixel in the sources (median), and the focal length."""
    distance = np.linalg.norm(np.linalg.inv(world_to_camera)[:, :3, 3], axis=1)
    low, high = 1 / (distance + 1), 1 / np.maximum(distance - 1, 0.1 * distance)
    focal = np.sqrt(np.abs(intrinsics[:, 0, 0] * intrinsics[:, 1, 1]))
    unit = (high - low) / 64
    for view in range(len(chosen)):
        moved = []
        for slot in np.flatnonzero(chosen[view] >= 0):
            a, b = matrices[view, slot, :9].reshape(3, 3).astype(float), matrices[view, slot, 9:12].astype(float)
            middle = intrinsics[view] @ world_to_camera[view][:3, 3]
            at = np.array([*(middle[:2] / middle[2]), 1.0]) if middle[2] > 1e-6 else np.array([0.0, 0.0, 1.0])
            ends = [a @ at + b * w for w in (low[view], high[view])]
            if min(end[2] for end in ends) > 1e-6:
                moved.append(np.linalg.norm(ends[1][:2] / ends[1][2] - ends[0][:2] / ends[0][2]))
        if moved:
            unit[view] = (high[view] - low[view]) / max(float(np.median(moved)), 1.0)
    return np.stack([low, high, unit, focal], axis=1).astype(np.float32)
