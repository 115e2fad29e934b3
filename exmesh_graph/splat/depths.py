"""Depth maps of fitted Gaussians for fusion, without what cannot be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from exmesh_graph.splat.fit import neighbours
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.planes import normals_of_depth, pixel_rays, plane_depth
from exmesh_graph.splat.render import Render, render
from exmesh_graph.stage1.targets import Targets
from exmesh_graph.types import DepthMaps


@dataclass(frozen=True)
class DepthFilter:
    """What is dropped; meanings and units are those of the node `prior.depth_from_gaussians`."""

    surface: Literal["middle", "blended"] = "middle"
    incidence: float = 80.0
    agreeing: int = 1
    tolerance: float = 0.01
    outward: float = 0.5


@torch.no_grad()
def depth_maps(gaussians: Gaussians, targets: Targets, keep: DepthFilter | None = None) -> tuple[DepthMaps, float]:
    """(unbiased depth of every view at the targets' size, 0 where dropped; the share of covered pixels kept).

    `surface`: the plane of the Gaussian at which half of the light is gone (middle), or the blended plane. Where the
    shell is soft the blended one lies too deep, because outlines hold its outermost layer only.

    Dropped: less than half covered, outside the mask, planes met at more than `incidence` degrees from their normal,
    and points that fewer than `agreeing` of up to eight neighbours show at the same depth, to `tolerance` of it.

    `outward` pixels are added along the surface's normal, since a fit shrinks the object by about half a pixel: a ray
    past the rim crosses the faint tails of so many Gaussians that together they cover it.
    """
    keep = keep or DepthFilter()
    depths = []
    covered = 0
    for i in range(len(targets)):
        rays = pixel_rays(targets.intrinsics[i], targets.height, targets.width, targets.images)
        drawing = render(gaussians, targets.intrinsics[i], targets.world_to_camera[i], targets.height, targets.width)
        normal, distance = drawing.normal, drawing.distance
        if keep.surface == "middle":
            normal, distance = middle_planes(gaussians, drawing, targets.world_to_camera[i])
        depth, valid = plane_depth(normal, distance, drawing.alpha, rays)
        lengths = (normal.square().sum(-1) * rays.square().sum(-1)).sqrt()
        cosine = -(normal * rays).sum(-1) / lengths.clamp(min=1e-12)
        covered += int((drawing.alpha > 0.5).sum())
        valid &= cosine > np.cos(np.radians(keep.incidence))
        if bool(targets.masked[i]):
            valid &= targets.alpha[i] >= 0.5
        depths.append(torch.where(valid, depth, 0.0))
    stack = torch.stack(depths)
    if keep.agreeing > 0:
        near = neighbours(targets.world_to_camera)
        stack = torch.stack([_agreed(i, near[i], targets, stack, keep) for i in range(len(targets))])
    if keep.outward > 0:
        stack = torch.stack([_outward(i, targets, stack[i], keep.outward) for i in range(len(targets))])
    names, kept = targets.names, int((stack > 0).sum())
    return DepthMaps(names, stack.cpu().numpy().astype(np.float32)), kept / max(covered, 1)


def _outward(i: int, targets: Targets, depth: torch.Tensor, pixels: float) -> torch.Tensor:
    """Depth nearer to the camera by what moves the surface `pixels` along its normal (at most three times as much)."""
    rays = pixel_rays(targets.intrinsics[i], targets.height, targets.width, depth)
    normals, known = normals_of_depth(depth, depth > 0, rays)
    facing = torch.where(known, -(normals * rays).sum(-1), 1.0).clamp(min=1 / 3)
    focal = float(targets.intrinsics[i, :2, :2].det().abs().sqrt())
    return torch.where(depth > 0, depth * (1 - pixels / focal / facing), 0.0)


def middle_planes(
    gaussians: Gaussians, drawing: Render, world_to_camera: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(normal [H, W, 3], distance [H, W]) in camera axes of the Gaussian at which half of the light is gone; else 0."""
    pose = world_to_camera.to(gaussians.means)
    points = gaussians.means @ pose[:3, :3].T + pose[:3, 3]
    normals = gaussians.normals() @ pose[:3, :3].T
    distances = (normals * points).sum(1)
    planes = torch.where((distances > 0)[:, None], -1.0, 1.0) * torch.cat([normals, distances[:, None]], dim=1)
    middle = drawing.drawn.middle
    found = planes[middle.clamp(min=0).long()]
    found = torch.where((middle >= 0)[..., None], found, 0.0)
    return found[..., :3], found[..., 3]


def _agreed(i: int, near: np.ndarray, targets: Targets, depths: torch.Tensor, keep: DepthFilter) -> torch.Tensor:
    """The view's depth where enough neighbours show the same point. A view with fewer neighbours asks those it has."""
    needed = min(keep.agreeing, len(near))
    height, width = targets.height, targets.width
    depth = depths[i]
    rays = pixel_rays(targets.intrinsics[i], height, width, depth)
    votes = torch.zeros_like(depth)
    for other in near.tolist():
        relative = (targets.world_to_camera[other] @ torch.linalg.inv(targets.world_to_camera[i])).to(depth)
        points = (depth[..., None] * rays) @ relative[:3, :3].T + relative[:3, 3]
        z = points[..., 2]
        place = points / z.clamp(min=1e-6)[..., None] @ targets.intrinsics[other].to(depth).T
        column, row = place[..., 0].floor().long(), place[..., 1].floor().long()
        inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        there = depths[other][row.clamp(0, height - 1), column.clamp(0, width - 1)]
        votes += inside & (there > 0) & ((there - z).abs() < keep.tolerance * z)
    return torch.where((depth > 0) & (votes >= needed), depth, 0.0)
