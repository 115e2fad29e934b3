"""From blended planes to depth and normals: plain torch, differentiable.

A picture of planar Gaussians holds N = sum w n and D = sum w d of planes n . x = d in camera axes. The ray r of a pixel
(z = 1) meets the blended plane at depth z = D / (N . r): weights cancel, so that depth lies on the plane however
transparent the pixel is, and not at Gaussians' centres (Chen et al. 2024, unbiased depth).
"""

from __future__ import annotations

import torch

from exmesh_graph.raster.camera import pixel_centres

COVERED = 0.5
_GRAZING = 0.05


def pixel_rays(intrinsics: torch.Tensor, height: int, width: int, like: torch.Tensor) -> torch.Tensor:
    """[H, W, 3], K^-1 (x, y, 1) at pixel centres: points at depth 1, in the type and on the device of `like`."""
    x, y = pixel_centres(height, width, dtype=torch.float64)
    grid = torch.stack([x.expand(height, width), y[:, None].expand(height, width), torch.ones(height, width).double()])
    rays = torch.linalg.inv(intrinsics.cpu().double()) @ grid.reshape(3, -1)
    return rays.T.reshape(height, width, 3).to(like)


def plane_depth(
    normal: torch.Tensor, distance: torch.Tensor, alpha: torch.Tensor, rays: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(depth [H, W] along the camera's axis, valid bool [H, W]) of blended normals, distances and coverage.

    Not valid, and 0, where less than half is covered or the plane is seen at less than about 3 degrees.
    """
    facing = (normal * rays).sum(-1)
    with torch.no_grad():
        length = (normal.square().sum(-1) * rays.square().sum(-1)).sqrt()
        valid = (alpha > COVERED) & (facing < -_GRAZING * length) & (distance < 0)
    return torch.where(valid, distance / torch.where(valid, facing, -1.0), 0.0), valid


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


def edge_weight(image: torch.Tensor, floor: float = 0.02) -> torch.Tensor:
    """[H, W] in [0, 1]: 1 where the picture [H, W, 3] is flat, 0 at its strongest edge; (1 - g / max g)^2.

    `floor` is the least maximum in display units: noise on a flat picture is no edge.
    """
    grey = image.mean(-1)
    slope = torch.zeros_like(grey)
    if min(grey.shape) >= 3:
        across = (grey[1:-1, 2:] - grey[1:-1, :-2]) / 2
        down = (grey[2:, 1:-1] - grey[:-2, 1:-1]) / 2
        slope[1:-1, 1:-1] = torch.hypot(across, down)
    return (1 - slope / slope.max().clamp(min=floor)).square()
