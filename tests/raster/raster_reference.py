"""The rasteriser by brute force in plain torch: every face against every pixel centre. For tests; any float type."""

from __future__ import annotations

import torch

from exmesh_graph.raster.camera import pixel_centres
from exmesh_graph.raster.rasterize import NEAR, Fragments


def rasterize_reference(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    height: int,
    width: int,
    *,
    near: float = NEAR,
    cull_back: bool = False,
) -> Fragments:
    """`rasterize` by ray-plane intersection: memory grows as faces times pixels.

    An independent derivation: the ray through a pixel centre, o + z d with d = R^T K^-1 (x, y, 1) so that z is the
    camera depth, is met with each face's plane, and the barycentric coordinates are signed area ratios in space.
    """
    dtype = vertices.dtype
    x, y = pixel_centres(height, width, dtype=dtype)
    grid = torch.stack([x.expand(height, width), y[:, None].expand(height, width), torch.ones(height, width).to(dtype)])
    rotation, shift = world_to_camera[:3, :3].to(dtype), world_to_camera[:3, 3].to(dtype)
    rays = (rotation.T @ torch.linalg.inv(intrinsics.to(dtype)) @ grid.reshape(3, -1)).T
    origin = -rotation.T @ shift

    face_id = torch.full((height * width,), -1, dtype=torch.int32)
    bary = torch.zeros((height * width, 3), dtype=dtype)
    depth = torch.full((height * width,), torch.inf, dtype=dtype)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f].long()]
        normal = torch.linalg.cross(b - a, c - a)
        area = normal.dot(normal)
        facing = rays @ normal
        z = (a - origin).dot(normal) / facing
        points = origin + z[:, None] * rays
        parts = [
            torch.linalg.cross((q - p).expand_as(points), points - p) @ normal / area
            for p, q in ((b, c), (c, a), (a, b))
        ]
        weights = torch.stack(parts, dim=1)
        hit = (weights >= 0).all(dim=1) & (z > near) & (z < depth)
        if cull_back:
            hit &= facing < 0
        face_id[hit] = f
        bary[hit] = weights[hit]
        depth[hit] = z[hit]
    depth[face_id < 0] = 0
    return Fragments(face_id.view(height, width), bary.view(height, width, 3), depth.view(height, width))
