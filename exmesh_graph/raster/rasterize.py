"""Which face is seen at each pixel centre: a software rasteriser in Warp, torch tensors in and out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from exmesh_graph.gpu.cores import share, split
from exmesh_graph.gpu.limits import EMPTY_KEY, check_indices, check_near, check_size
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.raster.camera import project
from exmesh_graph.raster.cover import Cover, cover, empty_cover
from exmesh_graph.raster.runtime import each_view, kernels

NEAR = 1e-3
"""Near plane in world units; the normalised world has the object inside the unit sphere."""

LARGE_FACE = 256
"""On CUDA, faces whose bounding box has more pixels than this are split into tiles over many threads."""


class Fragments(NamedTuple):
    """What is seen through each pixel centre; [N, H, W] where a batch of N views was asked for.

    face_id  int32 [H, W], -1 on the background
    bary     float32 [H, W, 3], perspective-correct barycentric coordinates, 0 on the background; empty where they
             were not asked for
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
    bary: bool = True,
) -> Fragments:
    """The nearest face at every pixel centre; not differentiable (see `interpolate` and `silhouette`).

    vertices         [V, 3] world positions, any float type (computed in float32)
    faces            integer [F, 3]
    intrinsics       [3, 3] pixels, any principal point;  world_to_camera [4, 4], OpenCV axes;
                     [N, 3, 3] and [N, 4, 4] (or one of them shared) for a batch of views of one size
    near             > 0; the part of a face with depth <= near is cut away exactly, per pixel
    cull_back        drop faces that are clockwise in the image; by default both sides are seen
    bary             whether barycentric coordinates are wanted: without them it is sooner done

    Rules: a centre on an edge belongs to all faces of that edge; of equal depths the lowest face index wins, so the
    result is the same on every run and device. Faces without area or with a vertex that is not finite are not seen.
    Raises ValueError for sizes beyond 32-bit indices (see `limits`) and for near <= 0, and on a CPU IndexError for
    faces of vertices that there are not.
    """
    with torch.no_grad():
        projected = project(vertices.detach().to(torch.float32), intrinsics, world_to_camera)
        return rasterize_projected(projected, faces, height, width, near=near, cull_back=cull_back, bary=bary)


def rasterize_projected(
    projected: torch.Tensor,
    faces: torch.Tensor,
    height: int,
    width: int,
    *,
    near: float = NEAR,
    cull_back: bool = False,
    bary: bool = True,
    large_face: int | None = None,
) -> Fragments:
    """`rasterize` for positions already in homogeneous pixel coordinates [V, 3] or [N, V, 3] (`camera.project`).

    large_face   pixels of a face's bounding box above which it is split into tiles, 0 never: a thread for each face or
                 tile. None is `LARGE_FACE` on CUDA, and on a CPU an item for each strip of rows (`cover`). The picture
                 is the same.
    """
    check_near(near)
    check_size(faces=len(faces), pixels=height * width)
    device = projected.device
    projected = projected.detach().to(torch.float32).contiguous()
    faces = faces.to(device, torch.int32).contiguous()
    check_indices("faces", faces, projected.shape[-2])
    if large_face is None and device.type == "cpu":
        return _in_strips(projected, faces, height, width, near, cull_back, bary)
    large_face = LARGE_FACE if large_face is None else large_face
    shape = (*projected.shape[:-2], height, width)
    keys = torch.full(shape, EMPTY_KEY, dtype=torch.int64, device=device)
    face_id = torch.full(shape, -1, dtype=torch.int32, device=device)
    weights = torch.zeros((*shape, 3), dtype=torch.float32, device=device)
    depth = torch.zeros(shape, dtype=torch.float32, device=device)
    if len(faces) and height * width:
        for points, key, *fragments in each_view(projected, keys, face_id, weights, depth):
            _cover(points, faces, height, width, near, cull_back, large_face, key)
            launch(kernels().resolve_fragments, height * width, points, faces, key, width, *fragments)
    return Fragments(face_id, weights if bary else weights.new_zeros(0), depth)


def _in_strips(
    projected: torch.Tensor, faces: torch.Tensor, height: int, width: int, near: float, cull_back: bool, bary: bool
) -> Fragments:
    shape = (*projected.shape[:-2], height, width)
    face_id, depth = torch.empty(shape, dtype=torch.int32), torch.empty(shape)
    weights = torch.empty((*shape, 3) if bary else (*shape, 0))
    _, _, boxes, shown = empty_cover(len(faces), 0, 0)
    for points, ids, z, each in each_view(projected, face_id, depth, weights):
        cover(points, faces, near, cull_back, Cover(ids, z, boxes, shown))
        if ids.numel() and bary:
            split(kernels().barycentrics_of, ids.numel(), points, faces, ids, width, each, grain=1 << 15)
    return Fragments(face_id, weights if bary else torch.empty(0), depth)


def contribution_counts(
    vertices: np.ndarray,
    faces: np.ndarray,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    supersample: int = 1,
) -> np.ndarray:
    """C_rend of the paper's section 4.2: how many pixels of all views show each face, int64 [F].

    Counted at `supersample` times the views' resolution.

    intrinsics float [N, 3, 3], camera_to_world float [N, 4, 4]; a face smaller than a pixel may be missed at 1.
    """
    points, triangles = tensor_of(vertices), tensor_of(faces)
    zoom = np.diag([supersample, supersample, 1.0])
    size = height * supersample, width * supersample

    def shown(intrinsic: np.ndarray, pose: np.ndarray) -> np.ndarray:
        camera = torch.from_numpy(zoom @ intrinsic), torch.from_numpy(np.linalg.inv(pose))
        seen = rasterize(points, triangles, *camera, *size, bary=False).face_id.cpu().numpy().reshape(-1)
        return np.bincount(seen[seen >= 0], minlength=len(faces))

    return np.stack(share(shown, intrinsics, camera_to_world)).sum(axis=0, dtype=np.int64)


def _cover(
    points: torch.Tensor,
    faces: torch.Tensor,
    height: int,
    width: int,
    near: float,
    cull_back: bool,
    large_face: int,
    keys: torch.Tensor,
) -> None:
    """Fill the keys of one view: small faces by a thread each, large ones by a thread for each of their tiles."""
    k = kernels()
    listed = len(faces) if large_face else 0
    large = torch.empty(listed, dtype=torch.int32, device=keys.device)
    first_tile = torch.empty(listed, dtype=torch.int64, device=keys.device)
    counts = torch.zeros(1, dtype=torch.int64, device=keys.device)
    view = (points, faces, height, width, near, int(cull_back))
    launch(k.rasterize_faces, len(faces), *view, large_face, keys, large, first_tile, counts)
    if large_face:
        packed = int(counts)
        count, tiles = packed >> int(k.LIST_SHIFT), packed & ((1 << int(k.LIST_SHIFT)) - 1)
        check_size(tiles=tiles)
        if tiles:
            launch(k.rasterize_tiles, tiles, *view, keys, large, first_tile, count)
