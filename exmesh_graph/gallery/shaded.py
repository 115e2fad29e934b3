"""Pictures of bare geometry: clay, normals, wires."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import rasterize
from exmesh_graph.types import Mesh

_WIRE_PIXELS = 0.6  # half the width of a wire


def shaded_geometry(
    mesh: Mesh, intrinsics: np.ndarray, camera_to_world: np.ndarray, height: int, width: int, scale: float = 1.5
) -> list[np.ndarray]:
    """Pictures [h, w, 3] in [0, 1] of the bare mesh: clay, normals (x, y, z as colours), wires over clay."""
    height, width = round(height * scale), round(width * scale)
    k = torch.from_numpy(np.diag([scale, scale, 1.0]) @ intrinsics)
    pose = torch.from_numpy(np.linalg.inv(camera_to_world))
    vertices = tensor_of(mesh.vertices)
    face_id = rasterize(vertices, tensor_of(np.asarray(mesh.faces, np.int32)), k, pose, height, width).face_id
    inside = face_id >= 0
    face = face_id[inside].long()
    corner = vertices[torch.from_numpy(mesh.faces.astype(np.int64))[face]]
    normal = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], dim=-1)
    normal = normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-20)
    towards = -pose[2, :3].to(normal)  # minus the viewing axis
    n_v = (normal * towards).sum(-1, keepdim=True)
    clay = (0.12 + 0.78 * n_v.abs()).expand(-1, 3) * torch.tensor([0.92, 0.88, 0.82])
    wires = torch.where(_edge_distance(corner, k, pose, inside)[:, None] < _WIRE_PIXELS, 0.15, 0.35 + 0.6 * clay)

    def picture(colors: torch.Tensor) -> np.ndarray:
        canvas = torch.ones(*face_id.shape, 3)
        canvas[inside] = colors.to(canvas)
        return canvas.numpy()

    return [picture(clay), picture(0.5 + 0.5 * normal), picture(wires)]


def _edge_distance(
    corner: torch.Tensor, intrinsics: torch.Tensor, pose: torch.Tensor, inside: torch.Tensor
) -> torch.Tensor:
    """Distance in pixels [N] from each covered pixel's centre to the nearest edge of its face."""
    matrix = pose.to(corner)
    seen = corner @ matrix[:3, :3].T + matrix[:3, 3]
    seen = seen @ intrinsics.to(corner).T
    xy = seen[..., :2] / seen[..., 2:].clamp_min(1e-6)
    row, column = torch.nonzero(inside, as_tuple=True)
    pixel = torch.stack([column, row], dim=1).to(xy) + 0.5
    distances = []
    for k in range(3):
        a, b = xy[:, k], xy[:, (k + 1) % 3]
        along = b - a
        cross = along[:, 0] * (pixel - a)[:, 1] - along[:, 1] * (pixel - a)[:, 0]
        distances.append(cross.abs() / along.norm(dim=1).clamp_min(1e-6))
    return torch.stack(distances).amin(0)
