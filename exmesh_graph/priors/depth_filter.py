"""Depth maps without what cannot be trusted: grazing surfaces, and points that neighbouring views contradict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.types import DepthMaps, Views

_PARALLAX = 10.0  # degrees between two viewing directions: enough for depth, little enough for windows to look alike
_NEIGHBOURS = 8


def filtered(
    views: Views, depths: DepthMaps, *, incidence: float = 0.0, agreeing: int = 0, tolerance: float = 0.01
) -> DepthMaps:
    """The depth maps of `views` (normalised units), 0 where dropped.

    incidence  degrees between a surface's normal, by differences of neighbouring pixels' points, and the viewing ray
               above which it is dropped, and pixels without a normal (beside a hole or the border) with it; 0: keep all
    agreeing   neighbours, of up to eight, that must show the same point, to `tolerance` of its depth; a view with fewer
               neighbours asks those it has; 0: none asked
    Raises DataError where views and depth maps do not belong together.
    """
    depths.require_of(views, "init.tsdf")
    stack = torch.from_numpy(depths.depth.copy())
    intrinsics, poses = torch.from_numpy(views.intrinsics), torch.from_numpy(views.world_to_camera)
    if incidence > 0:
        for i, depth in enumerate(stack):
            stack[i] = torch.where(_cosine(depth, intrinsics[i]) > np.cos(np.radians(incidence)), depth, 0.0)
    if agreeing > 0:
        near = neighbours(views.camera_to_world, _NEIGHBOURS)
        stack = agreed_views(near, stack, intrinsics, poses, agreeing, tolerance)
    return DepthMaps(depths.names, stack.numpy())


def agreed_views(
    near: Sequence[np.ndarray],
    depths: torch.Tensor,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    agreeing: int,
    tolerance: float,
) -> torch.Tensor:
    """`agreed` of every view of `depths` [N, H, W] by those `near` it, of which `agreeing` are needed, or all that a
    view has; the cores share the views."""

    def one(view: int) -> torch.Tensor:
        needed = min(agreeing, len(near[view]))
        return agreed(view, near[view], depths, intrinsics, world_to_camera, needed, tolerance)

    return torch.stack(share(one, range(len(depths))))


def agreed(
    view: int,
    others: np.ndarray,
    depths: torch.Tensor,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    needed: int,
    tolerance: float,
) -> torch.Tensor:
    """One view's depth [H, W] of `depths` [N, H, W] where `needed` of the `others` show the same point, else 0.

    The same: the other map's value at the pixel on which the point falls is its depth there, to `tolerance` of it.
    """
    height, width = depths.shape[1:]
    depth = depths[view]
    rays = pixel_rays(intrinsics[view], height, width, depth)
    votes = torch.zeros_like(depth)
    for other in others.tolist():
        relative = (world_to_camera[other] @ torch.linalg.inv(world_to_camera[view])).to(depth)
        points = (depth[..., None] * rays) @ relative[:3, :3].T + relative[:3, 3]
        z = points[..., 2]
        place = points / z.clamp(min=1e-6)[..., None] @ intrinsics[other].to(depth).T
        column, row = (place[..., axis].clamp(-1, n).floor().long() for axis, n in ((0, width), (1, height)))
        inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        there = depths[other][row.clamp(0, height - 1), column.clamp(0, width - 1)]
        votes += inside & (there > 0) & ((there - z).abs() < tolerance * z)
    return torch.where((depth > 0) & (votes >= needed), depth, 0.0)


def neighbours(camera_to_world: np.ndarray, count: int) -> list[np.ndarray]:
    """For each camera of [N, 4, 4] the `count` others that see the origin from most nearly 10 degrees away."""
    directions = -camera_to_world[:, :3, 3]
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    away = np.abs(np.log(np.maximum(angle, 1e-3) / _PARALLAX))
    np.fill_diagonal(away, np.inf)
    away[angle > 45] = np.inf
    order = np.argsort(away, axis=1, kind="stable")
    return [row[np.isfinite(away[i, row])][:count] for i, row in enumerate(order)]


def normals_of_depth(depth: torch.Tensor, valid: torch.Tensor, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(unit normals [H, W, 3] towards the camera, valid bool [H, W]) by central differences of the points seen.

    Valid where the pixel and its four neighbours are, and these are not all at one place.
    """
    points = depth[..., None] * rays
    across = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    crossed = torch.linalg.cross(down, across)
    square = crossed.square().sum(-1)
    inner = valid[1:-1, 1:-1] & valid[1:-1, 2:] & valid[1:-1, :-2] & valid[2:, 1:-1] & valid[:-2, 1:-1]
    inner = inner & (square > 0)
    unit = crossed * torch.where(inner, square, 1.0).rsqrt()[..., None]
    unit = torch.where(inner[..., None], unit, 0.0)
    pad = torch.nn.functional.pad
    return pad(unit, (0, 0, 1, 1, 1, 1)), pad(inner, (1, 1, 1, 1))


def _cosine(depth: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    """Cosine [H, W] between normals and the rays back to the camera; -1 where there is no normal."""
    rays = pixel_rays(intrinsics, depth.shape[0], depth.shape[1], depth)
    normals, known = normals_of_depth(depth, depth > 0, rays)
    return torch.where(known, -(normals * rays).sum(-1) / rays.norm(dim=-1), -1.0)
