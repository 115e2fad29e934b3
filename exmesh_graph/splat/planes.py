"""From blended planes to depth: plain torch, differentiable.

A picture of planar Gaussians holds N = sum w n and D = sum w d of planes n . x = d in camera axes. The ray r of a pixel
(z = 1) meets the blended plane at depth z = D / (N . r): weights cancel, so that depth lies on the plane however
transparent the pixel is, and not at Gaussians' centres (Chen et al. 2024, unbiased depth).
"""

from __future__ import annotations

import torch

COVERED = 0.5
_GRAZING = 0.05


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
