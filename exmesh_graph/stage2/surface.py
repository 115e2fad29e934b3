"""Surface samples of a frozen carrier: everything shading needs that does not depend on material or light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.geometry.adjacency import angle_weighted_normals, face_normals
from exmesh_graph.types import Carrier

#: A smooth normal may turn away from the camera near a silhouette; shading then sees it at this cosine.
GRAZING = 0.02


@dataclass(frozen=True)
class SurfaceSamples:
    """N points seen by a camera (float32 tensors; unit vectors).

    position, normal (interpolated), flat (geometric), view, reflected [N, 3]; n_v [N]; uv [N, 2];
    face int64 [N], bary [N, 3]
    """

    position: torch.Tensor
    normal: torch.Tensor
    flat: torch.Tensor
    view: torch.Tensor
    reflected: torch.Tensor
    n_v: torch.Tensor
    uv: torch.Tensor
    face: torch.Tensor
    bary: torch.Tensor

    def __len__(self) -> int:
        return len(self.n_v)


class CarrierGeometry:
    """A carrier's arrays as tensors, with its normals; rebuilds surface samples from faces and barycentrics."""

    def __init__(self, carrier: Carrier, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self.vertices = torch.from_numpy(carrier.vertices).to(device)
        self.faces = torch.from_numpy(carrier.faces.astype(np.int64)).to(device)
        self.uvs = torch.from_numpy(carrier.uvs).to(device)
        self.uv_faces = torch.from_numpy(carrier.uv_faces.astype(np.int64)).to(device)
        smooth = angle_weighted_normals(carrier.vertices, carrier.faces)
        flat = face_normals(carrier.vertices, carrier.faces)
        self.vertex_normals = torch.from_numpy(smooth.astype(np.float32)).to(device)
        self.face_normals = torch.from_numpy(flat.astype(np.float32)).to(device)

    def samples(self, face: torch.Tensor, bary: torch.Tensor, camera: torch.Tensor) -> SurfaceSamples:
        """The surface at `face` int64 [N], `bary` [N, 3], seen from `camera` [3] (world)."""
        corners = self.faces[face]
        position = _mix(self.vertices[corners], bary)
        normal = _unit(_mix(self.vertex_normals[corners], bary))
        flat = self.face_normals[face]
        view = _unit(camera.to(position) - position)
        n_v = (normal * view).sum(-1)
        # rays leave on the side that the camera sees, whichever way the face is wound
        facing = torch.where((flat * view).sum(-1, keepdim=True) < 0, -1.0, 1.0)
        bent = torch.where((n_v < GRAZING)[:, None], _unit(normal + (GRAZING - n_v)[:, None] * view), normal)
        n_v = (bent * view).sum(-1).clamp(1e-3, 1)
        reflected = _unit(2 * n_v[:, None] * bent - view)
        uv = _mix(self.uvs[self.uv_faces[face]], bary)
        return SurfaceSamples(position, bent, flat * facing, view, reflected, n_v, uv, face, bary)


def texel_footprint(uv: torch.Tensor, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Bilinear texels of `uv` [N, 2] (v up) in a size x size map (row 0 on top): flat index [N, 4], weight [N, 4]."""
    x = (uv[:, 0] * size - 0.5).clamp(0, size - 1)
    y = ((1 - uv[:, 1]) * size - 0.5).clamp(0, size - 1)
    x0, y0 = x.floor().clamp(max=max(size - 2, 0)), y.floor().clamp(max=max(size - 2, 0))
    fx, fy = x - x0, y - y0
    left, top = x0.long(), y0.long()
    right, bottom = (left + 1).clamp(max=size - 1), (top + 1).clamp(max=size - 1)
    index = torch.stack([top * size + left, top * size + right, bottom * size + left, bottom * size + right], 1)
    weight = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], 1)
    return index, weight


def _mix(corners: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
    return (corners * bary[..., None]).sum(1)


def _unit(vector: torch.Tensor) -> torch.Tensor:
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-12)
