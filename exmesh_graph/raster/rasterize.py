"""Which face is seen at each pixel centre: a software rasteriser in Warp, torch tensors in and out."""

from __future__ import annotations

from typing import NamedTuple

import torch

from exmesh_graph.raster.camera import project
from exmesh_graph.raster.warp_runtime import kernels, launch

NEAR = 1e-3
"""Near plane in world units; the normalised world has the object inside the unit sphere."""

_EMPTY_KEY = torch.iinfo(torch.int64).max


class Fragments(NamedTuple):
    """What is seen through each pixel centre.

    face_id  int32 [H, W], -1 on the background
    bary     float32 [H, W, 3], perspective-correct barycentric coordinates, 0 on the background
    depth    float32 [H, W], camera z, 0 on the background
    """

    face_id: torch.Tensor
    bary: torch.Tensor
    depth: torch.Tensor


def rasterize(
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
    """The nearest face at every pixel centre; not differentiable (see `interpolate` and `silhouette`).

    vertices         [V, 3] world positions, any float type (computed in float32)
    faces            integer [F, 3]
    intrinsics       [3, 3] pixels, any principal point;  world_to_camera [4, 4], OpenCV axes
    near             the part of a face with depth <= near is cut away exactly, per pixel
    cull_back        drop faces that are clockwise in the image; by default both sides are seen

    Rules: a centre on an edge belongs to all faces of that edge; of equal depths the lowest face index wins, so the
    result is the same on every run and device. Faces without area or with a vertex that is not finite are not seen.
    """
    with torch.no_grad():
        projected = project(vertices.detach().to(torch.float32), intrinsics, world_to_camera)
        return rasterize_projected(projected, faces, height, width, near=near, cull_back=cull_back)


def rasterize_projected(
    projected: torch.Tensor,
    faces: torch.Tensor,
    height: int,
    width: int,
    *,
    near: float = NEAR,
    cull_back: bool = False,
) -> Fragments:
    """`rasterize` for positions already in homogeneous pixel coordinates [V, 3] (`camera.project`)."""
    device = projected.device
    projected = projected.detach().to(torch.float32).contiguous()
    faces = faces.to(device, torch.int32).contiguous()
    keys = torch.full((height * width,), _EMPTY_KEY, dtype=torch.int64, device=device)
    face_id = torch.full((height, width), -1, dtype=torch.int32, device=device)
    bary = torch.zeros((height, width, 3), dtype=torch.float32, device=device)
    depth = torch.zeros((height, width), dtype=torch.float32, device=device)
    if len(faces) and height * width:
        k = kernels()
        launch(k.rasterize_faces, len(faces), projected, faces, height, width, near, int(cull_back), keys)
        launch(
            k.resolve_fragments,
            height * width,
            projected,
            faces,
            keys,
            width,
            face_id.view(-1),
            bary.view(-1, 3),
            depth.view(-1),
        )
    return Fragments(face_id, bary, depth)
