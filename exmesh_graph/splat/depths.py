"""Depth maps of fitted Gaussians for fusion, without what cannot be trusted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from exmesh_graph.gpu.cores import share
from exmesh_graph.priors.depth_filter import agreed_views, normals_of_depth
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.pictures import nearest_views
from exmesh_graph.splat.render import Render, plane_depth, render
from exmesh_graph.targets import Targets
from exmesh_graph.types import DepthMaps

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import DepthSettings


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
    shape = targets.height, targets.width

    @torch.no_grad()  # a thread's own switch
    def seen(i: int, inside: torch.Tensor | None) -> tuple[torch.Tensor, int]:
        """(a view's depth, pixels that are covered)."""
        camera = targets.intrinsics[i], targets.world_to_camera[i]
        rays, drawing = pixel_rays(camera[0], *shape, gaussians.means), render(gaussians, *camera, *shape)
        normal, distance = drawing.normal, drawing.distance
        if settings.surface == "middle":
            normal, distance = middle_planes(gaussians, drawing, camera[1])
        depth, valid = plane_depth(normal, distance, drawing.alpha, rays)
        lengths = (normal.square().sum(-1) * rays.square().sum(-1)).sqrt()
        cosine = -(normal * rays).sum(-1) / lengths.clamp(min=1e-12)
        valid &= cosine > np.cos(np.radians(settings.incidence))
        if inside is not None:
            valid &= inside
        return torch.where(valid, depth, 0.0), int((drawing.alpha > 0.5).sum())

    views = range(len(targets))
    masks = (targets.alpha[i] >= 0.5 if bool(targets.masked[i]) else None for i in views)
    depths, covered = zip(*share(seen, views, masks), strict=True)
    stack = torch.stack(depths)
    if settings.agreeing > 0:
        near = nearest_views(targets.world_to_camera)
        stack = agreed_views(
            near, stack, targets.intrinsics, targets.world_to_camera, settings.agreeing, settings.tolerance
        )
    if settings.outward > 0:
        stack = torch.stack(share(lambda i, depth: _outward(i, targets, depth, settings.outward), views, stack))
    names, kept = targets.names, int((stack > 0).sum())
    return DepthMaps(names, stack.cpu().numpy().astype(np.float32)), kept / max(sum(covered), 1)


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
