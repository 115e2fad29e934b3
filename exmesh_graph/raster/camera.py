"""Pinhole projection to homogeneous pixel coordinates."""

from __future__ import annotations

import torch

from exmesh_graph.errors import DataError


def project(vertices: torch.Tensor, intrinsics: torch.Tensor, world_to_camera: torch.Tensor) -> torch.Tensor:
    """Homogeneous pixel coordinates (x z, y z, z) of world points [V, 3]; differentiable in `vertices`.

    (x z, y z, z)^T = K (R v + t), with z the depth along the camera's axis (OpenCV: positive in front). Nothing is
    divided, so that points behind the camera are harmless; x, y are in pixels with pixel centres at +0.5.

    vertices         [V, 3], any float type; the result has its type and device
    intrinsics       [3, 3] with last row (0, 0, 1): any focal lengths, skew and principal point
    world_to_camera  [4, 4], rigid

    With a leading batch dimension in either camera argument ([N, 3, 3], [N, 4, 4]) the result is [N, V, 3].
    Raises DataError for arrays of another shape, or that are no tensors.
    """
    _require(vertices, intrinsics, world_to_camera)
    world_to_camera = world_to_camera.to(vertices.device, torch.float64)
    intrinsics = intrinsics.to(vertices.device, torch.float64)
    # K R and K t in float64 first: one rounding instead of two, and one matrix product over the vertices
    linear = (intrinsics @ world_to_camera[..., :3, :3]).to(vertices.dtype)
    offset = (intrinsics @ world_to_camera[..., :3, 3:]).to(vertices.dtype)
    return vertices @ linear.mT + offset.mT


def _require(vertices: torch.Tensor, intrinsics: torch.Tensor, world_to_camera: torch.Tensor) -> None:
    wanted = {"vertices": (vertices, "[V, 3]", (3,)), "intrinsics": (intrinsics, "[3, 3]", (3, 3)),
              "world_to_camera": (world_to_camera, "[4, 4]", (4, 4))}  # fmt: skip
    for name, (array, expected, tail) in wanted.items():
        if not isinstance(array, torch.Tensor):
            raise DataError(f"{name} is a {type(array).__name__}", where="project", expected=f"a tensor {expected}",
                            fix=f"torch.from_numpy({name})")  # fmt: skip
        if tuple(array.shape[-len(tail) :]) != tail:
            raise DataError(f"{name} has the shape {list(array.shape)}", where="project", expected=expected)


def pixel_centres(
    height: int, width: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> tuple[torch.Tensor, torch.Tensor]:
    """(x [W], y [H]) of the pixel centres, i + 0.5."""
    x = torch.arange(width, dtype=dtype, device=device) + 0.5
    y = torch.arange(height, dtype=dtype, device=device) + 0.5
    return x, y


def pixel_rays(intrinsics: torch.Tensor, height: int, width: int, like: torch.Tensor) -> torch.Tensor:
    """[H, W, 3], K^-1 (x, y, 1) at pixel centres: points at depth 1, in the type and on the device of `like`."""
    x, y = pixel_centres(height, width, dtype=torch.float64)
    grid = torch.stack([x.expand(height, width), y[:, None].expand(height, width), torch.ones(height, width).double()])
    rays = torch.linalg.inv(intrinsics.cpu().double()) @ grid.reshape(3, -1)
    return rays.T.reshape(height, width, 3).to(like)
