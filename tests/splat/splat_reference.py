"""Planar Gaussians drawn by plain torch: every Gaussian at every pixel, gradients by autograd; for tests."""

from __future__ import annotations

import torch

from exmesh_graph.raster.camera import pixel_centres
from exmesh_graph.splat.gaussians import Gaussians, harmonics, rotation_matrices
from exmesh_graph.splat.render import NEAR

_BLUR, _LEAST, _MOST, _OPAQUE, _MARGIN = 0.1, 1 / 255, 0.99, 1e-4, 0.15


def render_reference(
    gaussians: Gaussians,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    height: int,
    width: int,
    *,
    near: float = NEAR,
    degree: int | None = None,
) -> torch.Tensor:
    """[H, W, 8]: colour, normal, distance, alpha of `render`; memory grows as Gaussians times pixels."""
    dtype = gaussians.means.dtype
    rotation, shift = world_to_camera[:3, :3].to(dtype), world_to_camera[:3, 3].to(dtype)
    matrix = intrinsics.to(dtype)
    points = gaussians.means @ rotation.T + shift
    depth = points[:, 2]
    opacity = torch.sigmoid(gaussians.opacities)
    keep = torch.nonzero(depth > near)[:, 0]
    keep = keep[torch.argsort(depth[keep], stable=True)]
    points, opacity = points[keep], opacity[keep]
    world = rotation_matrices(gaussians.rotations[keep])

    # W Sigma W^T, then the local affine map of the projection
    covariance = world @ torch.diag_embed((2 * gaussians.scales[keep]).exp()) @ world.mT
    covariance = rotation @ covariance @ rotation.T
    slope = torch.stack([_held(points[:, :2] / points[:, 2:], matrix, height, width)[:, i] for i in (0, 1)], dim=1)
    flat = torch.cat([torch.eye(2, dtype=dtype).expand(len(keep), 2, 2), -slope[:, :, None]], dim=2)
    jacobian = matrix[:2, :2] @ flat / points[:, 2, None, None]
    sharp = jacobian @ covariance @ jacobian.mT
    spread = sharp + _BLUR * torch.eye(2, dtype=dtype)
    opacity = opacity * (_determinant(sharp) / _determinant(spread)).clamp(min=1e-30).sqrt()
    conic = torch.linalg.inv(spread)
    centre = (points[:, :2] / points[:, 2:]) @ matrix[:2, :2].T + matrix[:2, 2]

    axis = gaussians.scales[keep].argmin(dim=1)
    normal = (rotation @ world)[torch.arange(len(keep)), :, axis]
    normal = torch.where(((normal * points).sum(1) > 0)[:, None], -normal, normal)
    distance = (normal * points).sum(1)
    eye = -rotation.T @ shift
    direction = torch.nn.functional.normalize(gaussians.means[keep] - eye, dim=1)
    degree = gaussians.degree if degree is None else degree
    basis = harmonics(direction)[:, : (degree + 1) ** 2]
    colour = (torch.einsum("gk,gkc->gc", basis, gaussians.sh[keep, : (degree + 1) ** 2]) + 0.5).clamp(min=0)
    feature = torch.cat([colour, normal, distance[:, None], torch.ones_like(distance)[:, None]], dim=1)

    x, y = pixel_centres(height, width, dtype=dtype)
    pixels = torch.stack([x.expand(height, width), y[:, None].expand(height, width)], dim=-1).reshape(-1, 1, 2)
    offset = pixels - centre
    alpha = (opacity * torch.exp(-0.5 * torch.einsum("pgi,gij,pgj->pg", offset, conic, offset))).clamp(max=_MOST)
    alpha = torch.where(alpha >= _LEAST, alpha, 0)
    passed = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1 - alpha[:, :-1]], dim=1), dim=1)
    weight = torch.where(passed >= _OPAQUE, passed * alpha, 0)
    return (weight @ feature).view(height, width, 8)


def _determinant(m: torch.Tensor) -> torch.Tensor:
    return m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]


def _held(slope: torch.Tensor, matrix: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Slopes held within the picture grown by 15 %: the box of its corners' slopes."""
    ends = [(-_MARGIN * size, (1 + _MARGIN) * size) for size in (width, height)]
    corners = torch.tensor([[x, y] for x in ends[0] for y in ends[1]], dtype=matrix.dtype)
    bounds = torch.linalg.solve(matrix[:2, :2], (corners - matrix[:2, 2]).T)
    low, high = bounds.min(dim=1).values, bounds.max(dim=1).values
    return torch.minimum(torch.maximum(slope, low), high)
