"""Depth from the photographs themselves: a plane sweep with normalised cross-correlation (Collins 1996).

Each view is compared with a few neighbours under the homographies of planes at many depths; the depth at which windows
correlate best wins, and is kept where neighbours found the same point.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.priors.depth_filter import agreed, neighbours
from exmesh_graph.priors.settings import SweepSettings
from exmesh_graph.targets import Targets, prepare_targets
from exmesh_graph.types import DepthMaps, Views

_FLAT = 0.01  # windows whose standard deviation is below this, in display units, hold nothing to compare
_BATCH = 16  # planes at once


def plane_sweep(
    views: Views,
    settings: SweepSettings,
    *,
    device: torch.device | str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> DepthMaps:
    """Depth maps of `views` in normalised units, searched inside the unit sphere; 0 where nothing certain was found.

    Found at 1 / `downscale` of the pictures' size and given at full size (nearest value). Raises DataError for fewer
    than two views.
    """
    if len(views) < 2:
        raise DataError("one view alone has no parallax", where="prior.plane_sweep", expected="two views or more")
    targets = prepare_targets(views, downscale=settings.downscale, device=device)
    grey = torch.stack([image.mean(dim=-1) for image in targets.images])
    near = neighbours(views.camera_to_world, settings.neighbours)
    maps = []
    for view in range(len(targets)):
        maps.append(search_depths(view, near[view], targets, grey, settings))
        if progress is not None:
            progress(view + 1, len(targets))
    depth = torch.stack(maps)
    cameras = targets.intrinsics, targets.world_to_camera
    kept = torch.stack([
        agreed(view, near[view], depth, *cameras, settings.agreeing, settings.tolerance) for view in range(len(targets))
    ])  # fmt: skip
    if views.has_masks:
        for depths, alpha in zip(kept, targets.alpha, strict=True):
            depths.masked_fill_(~(alpha > 0.5), 0.0)
    return DepthMaps(views.names, _enlarged(kept.cpu().numpy(), views.height, views.width, settings.downscale))


def search_depths(
    view: int, others: np.ndarray, targets: Targets, grey: torch.Tensor, settings: SweepSettings
) -> torch.Tensor:
    """Depth [H, W] of one view before the check against its neighbours; 0 where windows are flat or do not match."""
    height, width = targets.height, targets.width
    distance = float(torch.linalg.inv(targets.world_to_camera[view])[:3, 3].norm())
    ends = 1 / max(distance - 1, 0.1 * distance), 1 / (distance + 1)
    inverse = torch.linspace(*ends, settings.planes, dtype=grey.dtype, device=grey.device)
    mean = _box(grey[view][None], settings.window)[0]
    variance = _box(grey[view][None].square(), settings.window)[0] - mean.square()
    scores = grey.new_full((len(others), settings.planes, height, width), -1.0)
    for k, other in enumerate(others.tolist()):
        slope, offset = _transfer(view, other, targets, grey)
        for start in range(0, settings.planes, _BATCH):
            part = slice(start, min(start + _BATCH, settings.planes))
            # z slope + offset, up to a factor
            place = slope[None] + inverse[part, None, None, None] * offset
            x, y = place[..., 0] / place[..., 2], place[..., 1] / place[..., 2]
            inside = (place[..., 2] > 0) & (x > 0.5) & (x < width - 0.5) & (y > 0.5) & (y < height - 0.5)
            at = torch.stack([2 * x / width - 1, 2 * y / height - 1], dim=-1).clamp(-2, 2)
            seen = torch.nn.functional.grid_sample(
                grey[other].expand(len(at), 1, -1, -1), at, mode="bilinear", padding_mode="border", align_corners=False
            )[:, 0]
            there = _box(seen, settings.window)
            spread = _box(seen.square(), settings.window) - there.square()
            shared = _box(seen * grey[view], settings.window) - there * mean
            score = shared / (variance * spread).clamp(min=_FLAT**4).sqrt()
            scores[k, part] = torch.where(inside, score, -1.0)
    # the better half: a neighbour that does not see the point has no say
    best = scores.sort(dim=0, descending=True).values[: max(1, (len(others) + 1) // 2)].mean(dim=0)
    top, plane = best.max(dim=0)
    step = inverse[1] - inverse[0]
    middle = plane.clamp(1, settings.planes - 2)
    low, centre, high = (best.gather(0, (middle + d)[None])[0] for d in (-1, 0, 1))
    bend = low - 2 * centre + high
    shift = torch.where(bend < -1e-6, 0.5 * (low - high) / bend, 0.0).clamp(-0.5, 0.5)
    depth = 1 / (inverse[middle] + shift * step)
    sure = (top > settings.min_score) & (variance > _FLAT**2) & (plane == middle)
    return torch.where(sure, depth, 0.0)


def _transfer(view: int, other: int, targets: Targets, like: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A [H, W, 3] and b [3]: the point of a pixel at depth z lies at z A + b in the other view's homogeneous pixels."""
    height, width = targets.height, targets.width
    relative = targets.world_to_camera[other] @ torch.linalg.inv(targets.world_to_camera[view])
    forth = targets.intrinsics[other] @ relative[:3, :3] @ torch.linalg.inv(targets.intrinsics[view])
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) + 0.5 for n in (height, width)), indexing="ij")
    slope = torch.stack([x, y, torch.ones_like(x)], dim=-1) @ forth.T
    return slope.to(like), (targets.intrinsics[other] @ relative[:3, 3]).to(like)


def _box(planes: torch.Tensor, window: int) -> torch.Tensor:
    """Means of [N, H, W] over windows, at the border over what lies inside."""
    reach = window // 2
    for axis in (1, 2):
        size = planes.shape[axis]
        padding = (0, 0, reach, reach) if axis == 1 else (reach, reach)
        wide = torch.nn.functional.pad(planes, padding)
        # sums of shifted slices: several times faster on a CPU than pooling
        total = wide.narrow(axis, 0, size).clone()
        for shift in range(1, window):
            total += wide.narrow(axis, shift, size)
        place = torch.arange(size, device=planes.device)
        count = (place + reach).clamp(max=size - 1) - (place - reach).clamp(min=0) + 1
        planes = total / count.to(total).view(-1, 1) if axis == 1 else total / count.to(total)
    return planes


def _enlarged(maps: np.ndarray, height: int, width: int, factor: int) -> np.ndarray:
    """Each value over its `factor` x `factor` pixels; rows and columns that the factor left over stay 0."""
    out = np.zeros((len(maps), height, width), np.float32)
    large = maps.repeat(factor, axis=1).repeat(factor, axis=2)
    out[:, : large.shape[1], : large.shape[2]] = large
    return out
