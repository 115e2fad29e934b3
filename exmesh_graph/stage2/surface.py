"""Surface samples of a frozen carrier: what shading needs that depends on no light, and normals under a normal map.

A normal map is fitted as slopes (s, t): n' ~ s T + t B + N, in the frame of geometry.tangents, interpolated over the
face and not normalised before use (MikkTSpace). z stays above 0 for any slope.

Diffuse light under the bent normal, exact to first order (Ramamoorthi and Hanrahan's gradient of irradiance without the
change of horizon): with the vector irradiance F(p) = sum_k V_k L_k w_k over the directions above the smooth horizon,
E(n') = max(E(n) + (n' - n) . F, 0), equal to E(n) where the map is flat.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from exmesh_graph.geometry.adjacency import angle_weighted_normals, face_normals
from exmesh_graph.geometry.tangents import corner_tangents
from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.gpu.warp_runtime import warp
from exmesh_graph.shading.monte_carlo.points import mixed
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

    def __getitem__(self, part: slice | torch.Tensor) -> SurfaceSamples:
        return SurfaceSamples(*(values[part] for values in vars(self).values()))

    def joined(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        """Whether pairs of points, by their numbers, lie on one surface, bool of that shape: the step between them
        stays near both tangent planes (a jump in depth is no neighbourhood of the material)."""
        step = self.position[first] - self.position[second]
        length = step.norm(dim=-1).clamp_min(1e-12)
        slope = torch.maximum((step * self.flat[first]).sum(-1).abs(), (step * self.flat[second]).sum(-1).abs())
        return slope < 0.5 * length


class CarrierGeometry:
    """A carrier's arrays as tensors, with its normals; rebuilds surface samples from faces and barycentrics."""

    def __init__(self, carrier: Carrier, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self.vertices = tensor_of(carrier.vertices).to(device)
        self.faces = torch.from_numpy(carrier.faces.astype(np.int64)).to(device)
        self.uvs = tensor_of(carrier.uvs).to(device)
        self.uv_faces = torch.from_numpy(carrier.uv_faces.astype(np.int64)).to(device)
        smooth = angle_weighted_normals(carrier.vertices, carrier.faces)
        flat = face_normals(carrier.vertices, carrier.faces)
        self.vertex_normals = torch.from_numpy(smooth.astype(np.float32)).to(device)
        self.face_normals = torch.from_numpy(flat.astype(np.float32)).to(device)

    def samples(self, face: torch.Tensor, bary: torch.Tensor, camera: torch.Tensor) -> SurfaceSamples:
        """The surface at `face` int64 [N], `bary` [N, 3], seen from `camera` [3] (world)."""
        if self.device.type != "cpu" or not self.vertices.dtype == bary.dtype == torch.float32:
            return self.plain_samples(face, bary, camera)
        count = len(face)
        outputs = [torch.empty(count, *shape) for shape in ((3,), (3,), (3,), (3,), (3,), (), (2,))]
        if count:
            split(
                _kernels().surface_samples, count, GRAZING, camera.float(), face, bary.contiguous(), self.vertices,
                self.vertex_normals, self.faces, self.face_normals, self.uvs, self.uv_faces, *outputs, grain=2048,
            )  # fmt: skip
        position, normal, flat, view, reflected, n_v, uv = outputs
        return SurfaceSamples(position, normal, flat, view, reflected, n_v, uv, face, bary)

    def plain_samples(self, face: torch.Tensor, bary: torch.Tensor, camera: torch.Tensor) -> SurfaceSamples:
        """`samples` in torch: the reference, and the form of other devices and dtypes."""
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


class TangentFrames:
    """A carrier's tangents per face corner [F, 3, 3] and the handedness of its faces [F]."""

    def __init__(self, carrier: Carrier, device: torch.device | str = "cpu") -> None:
        tangent, sign = corner_tangents(carrier.vertices, carrier.faces, carrier.uvs, carrier.uv_faces)
        self.tangent, self.sign = torch.from_numpy(tangent).to(device), torch.from_numpy(sign).to(device)

    def at(
        self, geometry: CarrierGeometry, face: torch.Tensor, bary: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Tangent, bitangent and normal [N, 3] at `face` int64 [N], `bary` [N, 3]; interpolated, not unit."""
        normal = mixed(geometry.vertex_normals, geometry.faces, face, bary)
        corners = self.tangent[face]
        tangent = corners[:, 0] * bary[:, :1] + corners[:, 1] * bary[:, 1:2] + corners[:, 2] * bary[:, 2:]
        return tangent, self.sign[face][:, None] * torch.linalg.cross(normal, tangent, dim=-1), normal


def bent(surface: SurfaceSamples, frame: tuple[torch.Tensor, ...], slopes: torch.Tensor) -> SurfaceSamples:
    """`surface` with its normal, reflected direction and n_v under the map's `slopes` [N, 2]; differentiable."""
    tangent, bitangent, normal = frame
    mapped = F.normalize(slopes[:, :1] * tangent + slopes[:, 1:] * bitangent + normal, dim=-1)
    mapped, n_v, reflected = turned_to(mapped, surface.view)
    return replace(surface, normal=mapped, reflected=reflected, n_v=n_v)


def turned_to(normal: torch.Tensor, view: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Unit `normal` [N, 3] as a camera in direction `view` [N, 3] shades it, n_v [N] and the mirrored direction [N, 3].

    A normal turned away from the camera is bent back to a grazing one, as smooth normals are. Differentiable.
    """
    short = (GRAZING - (normal * view).sum(-1)).clamp_min(0)
    normal = F.normalize(normal + short[:, None] * view, dim=-1)
    n_v = (normal * view).sum(-1).clamp(1e-3, 1)
    reflected = F.normalize(2 * n_v[:, None] * normal - view, dim=-1)
    # longitude has no derivative at the poles: a direction there is taken as one next to it
    beside = torch.tensor([1e-3, 1.0, 0.0]).to(reflected) * torch.sign(reflected[:, 1:2])
    return normal, n_v, torch.where(reflected[:, 1:2].abs() > 1 - 1e-6, beside, reflected)


def mapped_surface(
    surface: SurfaceSamples, geometry: CarrierGeometry, frames: TangentFrames | None, slopes: torch.Tensor | None
) -> SurfaceSamples:
    """`surface` under the `slopes` [N, 2] of a normal map; as it is where there is no map (None).

    Equation: 11.
    """
    if frames is None or slopes is None:
        return surface
    return bent(surface, frames.at(geometry, surface.face, surface.bary), slopes)


def bent_irradiance(
    irradiance: torch.Tensor, vector: torch.Tensor, smooth: torch.Tensor, mapped: torch.Tensor
) -> torch.Tensor:
    """E(n') [N, 3] from E(n) `irradiance` [N, 3], the vector irradiance [N, 9] (x, y, z of rgb), n and n' [N, 3]."""
    turned = ((mapped - smooth)[:, :, None] * vector.reshape(-1, 3, 3)).sum(1)
    return (irradiance + turned).clamp_min(0)


def slopes_of(normal: np.ndarray) -> np.ndarray:
    """Slopes float32 [..., 2] of unit tangent-space normals [..., 3], z > 0 (floored at 0.05)."""
    return (normal[..., :2] / np.maximum(normal[..., 2:], 0.05)).astype(np.float32)


def normals_of(slopes: np.ndarray) -> np.ndarray:
    """Unit tangent-space normals float32 [..., 3] of slopes [..., 2]."""
    upright = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    return (upright / np.linalg.norm(upright, axis=-1, keepdims=True)).astype(np.float32)


@cache
def _kernels() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.stage2 import kernels_surface

    return kernels_surface


def _mix(corners: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
    return (corners * bary[..., None]).sum(1)


def _unit(vector: torch.Tensor) -> torch.Tensor:
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-12)
