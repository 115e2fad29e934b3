"""Depth maps of fitted Gaussians for fusion, without what cannot be trusted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from exmesh_graph.priors.depth_filter import agreed, normals_of_depth
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.pictures import nearest_views
from exmesh_graph.splat.render import Render, plane_depth, render
from exmesh_graph.targets import Targets
from exmesh_graph.types import DepthMaps

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import DepthSettings


@torch.no_grad()
def depth_maps(gaussians: Gaussians, targets: Targets, settings: DepthSettings) -> tuple[DepthMaps, float]:
    """(unbiased depth of every view at the targets' size, 0 where dropped; the share of covered pixels kept).

    `surface`: the plane of the Gaussian at which half of the light is gone (middle), or the blended plane. Where the
    shell is soft the blended one lies too deep, because outlines hold its outermost layer only.

    Dropped: less than half covered, outside the mask, planes met at more than `incidence` degrees from their normal,
    and points that fewer than `agreeing` of up to eight neighbours show at the same depth, to `tolerance` of it
    (a view with fewer neighbours asks those it has).

    `outward` pixels are added along the surface's normal, since a fit shrinks the object by about half a pixel: a ray
    past the rim crosses the faint tails of so many Gaussians that together they cover it.
    """
    depths = []
    covered = 0
    for i in range(len(targets)):
        rays = pixel_rays(targets.intrinsics[i], targets.height, targets.width, targets.images[i])
        drawing = render(gaussians, targets.intrinsics[i], targets.world_to_camera[i], targets.height, targets.width)
        normal, distance = drawing.normal, drawing.distance
        if settings.surface == "middle":
            normal, distance = middle_planes(gaussians, drawing, targets.world_to_camera[i])
        depth, valid = plane_depth(normal, distance, drawing.alpha, rays)
        lengths = (normal.square().sum(-1) * rays.square().sum(-1)).sqrt()
        cosine = -(normal * rays).sum(-1) / lengths.clamp(min=1e-12)
        covered += int((drawing.alpha > 0.5).sum())
        valid &= cosine > np.cos(np.radians(settings.incidence))
        if bool(targets.masked[i]):
            valid &= targets.alpha[i] >= 0.5
        depths.append(torch.where(valid, depth, 0.0))
    stack = torch.stack(depths)
    if settings.agreeing > 0:
        near = nearest_views(targets.world_to_camera)
        cameras = targets.intrinsics, targets.world_to_camera
        stack = torch.stack([
            agreed(i, near[i], stack, *cameras, min(settings.agreeing, len(near[i])), settings.tolerance)
            for i in range(len(targets))
        ])  # fmt: skip
    if settings.outward > 0:
        stack = torch.stack([_outward(i, targets, stack[i], settings.outward) for i in range(len(targets))])
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
    chosen = planes[middle.clamp(min=0).long()]
    chosen = torch.where((middle >= 0)[..., None], chosen, 0.0)
    return chosen[..., :3], chosen[..., 3]
