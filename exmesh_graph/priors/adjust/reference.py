"""What patches of one view say of the cameras, in plain torch: what the kernel is tested against."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.priors.adjust.patches import Patches
from exmesh_graph.priors.adjust.system import FLAT, FLOOR, ROBUST, Level, placed


def compared(
    level: Level, view: int, patches: Patches, logs: np.ndarray, sources: np.ndarray, poses: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `system.compared`."""
    matrix = level.intrinsics[view]
    at, local = placed(patches, logs, matrix[[0, 1], [0, 1]], level.lens)
    x, y = (torch.from_numpy(matrix[k, k] * at[..., k] + matrix[k, 2]) for k in (0, 1))
    values, shown = _sampled(level.values[view], x, y)
    unit, spread = _unit(values[..., 0])
    shown &= spread > FLAT
    turn = poses[view, :3, :3]
    by_lens = _by_lens(local, level.lens.bend)
    along = torch.stack([torch.from_numpy(one @ turn.T) for one in (local, *by_lens)], dim=-1)
    places = along[..., 0] + torch.from_numpy(poses[view, :3, 3])
    products, off, alike = [], [], []
    for source in sources:
        other, slopes, seen, other_spread = _seen(level, int(source), places, along, poses)
        seen &= shown & (other_spread > FLAT)
        correlation = (other * unit).mean(dim=1)
        weight = torch.where(seen, (1 + 2 * (1 - correlation) / ROBUST) ** -2, 0.0)
        weighted = slopes * weight[:, None, None]
        products.append(torch.einsum("pna,pnb->pab", weighted, slopes))
        off.append(torch.einsum("pna,pn->pa", weighted, other - unit))
        alike.append(torch.where(seen, correlation, -2.0))
    return tuple(torch.stack(parts, dim=1).numpy() for parts in (products, off, alike))  # type: ignore[return-value]


def _by_lens(local: np.ndarray, bend: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of places [P, 9, 3] in the camera's axes by g and b."""
    square = np.square(local[..., :2] / local[..., 2:]).sum(axis=-1, keepdims=True)
    inward = local * [-1.0, -1.0, 0.0] / (1 + 3 * bend * square)
    return inward * (1 + bend * square), inward * square


def _seen(
    level: Level, source: int, places: torch.Tensor, along: torch.Tensor, poses: np.ndarray
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """(z' [P, 9], its derivatives by the twist (o, v), by l, g and b [P, 9, 9], whether it is in the picture [P],
    deviation [P]) of `source`; `along` [P, 9, 3, 3], derivatives of `places` by l, g and b."""
    turn = torch.from_numpy(np.ascontiguousarray(poses[source, :3, :3]))  # to the world
    local = (places - torch.from_numpy(poses[source, :3, 3])) @ turn
    matrix, zoom, bend = level.intrinsics[source], level.lens.zoom, level.lens.bend
    depth = local[..., 2].clamp(min=1e-3)
    rays = local[..., :2] / depth[..., None]
    square = rays.square().sum(dim=-1)
    shown_at = zoom * rays * (1 + bend * square)[..., None]
    x, y = (matrix[k, k] * shown_at[..., k] + matrix[k, 2] for k in (0, 1))
    values, shown = _sampled(level.values[source], x, y)
    shown &= (local[..., 2] > 1e-3).all(dim=1)
    outward = zoom * torch.stack([values[..., 1] * matrix[0, 0], values[..., 2] * matrix[1, 1]], dim=-1)
    radial = (outward * rays).sum(dim=-1)
    by_ray = outward * (1 + bend * square)[..., None] + 2 * bend * radial[..., None] * rays
    in_camera = torch.cat([by_ray, -(by_ray * rays).sum(dim=-1, keepdim=True)], dim=-1) / depth[..., None]
    in_world = in_camera @ turn.T
    by_lens = torch.stack([torch.zeros_like(radial), radial * (1 + bend * square), radial * square], dim=-1)
    moving = (in_world[..., None] * along).sum(dim=-2) + by_lens
    slopes = torch.cat([torch.linalg.cross(places, in_world), in_world, moving], dim=-1)
    unit, spread = _unit(values[..., 0])
    # z is of unit deviation and without mean: what only changes these does not change it
    slopes = slopes - slopes.mean(dim=1, keepdim=True)
    over = (spread + FLOOR)[:, None, None]
    spreading = (unit[..., None] * slopes).mean(dim=1, keepdim=True) * over / (over - FLOOR).clamp(min=1e-9)
    return unit, (slopes - unit[..., None] * spreading) / over, shown, spread


def _unit(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(z [P, n], deviations [P]) of values [P, n]."""
    off = values - values.mean(dim=1, keepdim=True)
    spread = off.square().mean(dim=1).sqrt()
    return off / (spread + FLOOR)[:, None], spread


def _sampled(picture: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(bilinear values float64 [P, n, C] of a picture [h, w, C] at pixels, centres at +0.5; bool [P], all inside)."""
    height, width, channels = picture.shape
    x, y = x - 0.5, y - 0.5
    inside = ((x >= 0) & (y >= 0) & (x <= width - 1.001) & (y <= height - 1.001)).all(dim=1)
    x, y = x.clamp(0, width - 1.001), y.clamp(0, height - 1.001)
    left, top = x.long(), y.long()
    across, down = (x - left)[..., None], (y - top)[..., None]
    flat, at = picture.reshape(-1, channels), top * width + left
    upper = flat[at] * (1 - across) + flat[at + 1] * across
    lower = flat[at + width] * (1 - across) + flat[at + width + 1] * across
    return upper * (1 - down) + lower * down, inside
