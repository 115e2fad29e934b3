"""The planes that a level begins with: at random, from points, or from the level before."""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from exmesh_graph.priors.patch_match.layout import Level

_SLOPE = 1.5  # change of depth, as a share of it, over a focal length
_REACH = 0.05  # of the picture's longer side: how far around its pixel a point says where the search begins
_COST = 2.0


def random_planes(level: Level, bounds: torch.Tensor, seed: int) -> torch.Tensor:
    """Planes float32 [N, 4, H, W] (w, du, dv, cost) all over the search: bounds [N, 4] of `sources.search_bounds`."""
    low, high, _, focal = (bounds[:, i, None, None] for i in range(4))
    generator = torch.Generator().manual_seed(seed)
    planes = torch.rand((len(bounds), 4, level.height, level.width), generator=generator)
    planes[:, 0] = low + (high - low) * planes[:, 0]
    planes[:, 1:3] = (planes[:, :1] / focal[:, None]) * _SLOPE * (2 * planes[:, 1:3] - 1)
    planes[:, 3] = _COST
    return planes


def begin_at_points(
    planes: torch.Tensor,
    points: np.ndarray,
    intrinsics: np.ndarray,
    world_to_camera: np.ndarray,
    bounds: torch.Tensor,
) -> None:
    """Give pixels near a projected point (of [P, 3], the nearest in the picture) its inverse depth; in place.

    A guess only: hidden points and outliers are among them, and an iteration soon leaves what does not fit.
    """
    _, _, height, width = planes.shape
    for view, (k, pose) in enumerate(zip(intrinsics, world_to_camera, strict=True)):
        local = np.asarray(points, float) @ pose[:3, :3].T + pose[:3, 3]
        z = local[:, 2]
        low, high = (float(bounds[view, i]) for i in (0, 1))
        with np.errstate(all="ignore"):
            image = local @ k.T / z[:, None]
            held = (z > 1e-6) & (1 / z >= low) & (1 / z <= high)
            held &= (image[:, :2] >= 0).all(axis=1) & (image[:, 0] < width) & (image[:, 1] < height)
        if not held.any():
            continue
        # far ones first: where several fall on a pixel the nearest stays
        order = np.flatnonzero(held)[np.argsort(-z[held], kind="stable")]
        known = np.zeros((height, width), np.float32)
        known[image[order, 1].astype(int), image[order, 0].astype(int)] = 1 / z[order]
        distance, (rows, columns) = distance_transform_edt(known == 0, return_indices=True)
        near = torch.from_numpy(distance <= _REACH * max(height, width))
        guess = torch.from_numpy(known[rows, columns])
        planes[view, 0] = torch.where(near, guess, planes[view, 0])


def finer(planes: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Planes [N, 4, H, W] for a picture of height x width, about twice their size: of the pixel over each pixel."""
    rows, columns = (
        (torch.arange(n) // 2).clamp(max=most - 1)
        for n, most in zip((height, width), planes.shape[2:], strict=True)
    )  # fmt: skip
    fine = planes[:, :, rows][:, :, :, columns]
    y = (torch.arange(height) + 0.5) / 2 - rows - 0.5
    x = (torch.arange(width) + 0.5) / 2 - columns - 0.5
    w = fine[:, 0] + fine[:, 1] * x + fine[:, 2] * y[:, None]
    return torch.stack([w, fine[:, 1] / 2, fine[:, 2] / 2, fine[:, 3]], dim=1)


def enlarged(w: torch.Tensor, slopes: torch.Tensor, height: int, width: int, factor: int) -> torch.Tensor:
    """Inverse depth [height, width] of [h, w] at 1 / factor of the size, along each pixel's plane: slopes [2, h, w].

    0 stays 0, and rows and columns that the factor left over are 0.
    """
    out = w.new_zeros((height, width))
    offset = (torch.arange(factor) + 0.5) / factor - 0.5
    x, y = offset.repeat(w.shape[1]), offset.repeat(w.shape[0])[:, None]
    large = [a.repeat_interleave(factor, 0).repeat_interleave(factor, 1) for a in (w, slopes[0], slopes[1])]
    along = large[0] + large[1] * x + large[2] * y
    along = torch.where((large[0] > 0) & (along > 0.5 * large[0]), along, large[0])
    out[: along.shape[0], : along.shape[1]] = along
    return out
