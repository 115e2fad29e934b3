"""Shading normals bent by a tangent-space normal map, and diffuse light under them.

The map is fitted as slopes (s, t): n' ~ s T + t B + N, in the frame of geometry.tangents, interpolated over the face
and not normalised before use (MikkTSpace). z stays above 0 for any slope.

Diffuse light under the bent normal, exact to first order (Ramamoorthi and Hanrahan's gradient of irradiance without the
change of horizon): with the vector irradiance F(p) = sum_k V_k L_k w_k over the directions above the smooth horizon,
E(n') = max(E(n) + (n' - n) . F, 0), equal to E(n) where the map is flat.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as functional

from exmesh_graph.geometry.tangents import corner_tangents
from exmesh_graph.stage2.surface import GRAZING, CarrierGeometry, SurfaceSamples
from exmesh_graph.types import Carrier

if TYPE_CHECKING:
    from exmesh_graph.stage2.gbuffer import ViewBuffer
    from exmesh_graph.stage2.maps import Material


class TangentFrames:
    """A carrier's tangents per face corner [F, 3, 3] and the handedness of its faces [F]."""

    def __init__(self, carrier: Carrier, device: torch.device | str = "cpu") -> None:
        tangent, sign = corner_tangents(carrier.vertices, carrier.faces, carrier.uvs, carrier.uv_faces)
        self.tangent, self.sign = torch.from_numpy(tangent).to(device), torch.from_numpy(sign).to(device)

    def at(
        self, geometry: CarrierGeometry, face: torch.Tensor, bary: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Tangent, bitangent and normal [N, 3] at `face` int64 [N], `bary` [N, 3]; interpolated, not unit."""
        normal = (geometry.vertex_normals[geometry.faces[face]] * bary[..., None]).sum(1)
        tangent = (self.tangent[face] * bary[..., None]).sum(1)
        return tangent, self.sign[face][:, None] * torch.linalg.cross(normal, tangent, dim=-1), normal


def bent(surface: SurfaceSamples, frame: tuple[torch.Tensor, ...], slopes: torch.Tensor) -> SurfaceSamples:
    """`surface` with its normal, reflected direction and n_v under the map's `slopes` [N, 2]; differentiable.

    A normal turned away from the camera is bent back to a grazing one, as smooth normals are.

    Equation: 11.
    """
    tangent, bitangent, normal = frame
    mapped = functional.normalize(slopes[:, :1] * tangent + slopes[:, 1:] * bitangent + normal, dim=-1)
    n_v = (mapped * surface.view).sum(-1)
    short = (GRAZING - n_v).clamp_min(0)
    mapped = functional.normalize(mapped + short[:, None] * surface.view, dim=-1)
    n_v = (mapped * surface.view).sum(-1).clamp(1e-3, 1)
    reflected = functional.normalize(2 * n_v[:, None] * mapped - surface.view, dim=-1)
    # longitude has no derivative at the poles: a direction there is taken as one next to it
    beside = torch.tensor([1e-3, 1.0, 0.0]).to(reflected) * torch.sign(reflected[:, 1:2])
    reflected = torch.where(reflected[:, 1:2].abs() > 1 - 1e-6, beside, reflected)
    return replace(surface, normal=mapped, reflected=reflected, n_v=n_v)


def mapped_surface(
    buffer: ViewBuffer, geometry: CarrierGeometry, frames: TangentFrames | None, material: Material | None
) -> SurfaceSamples:
    """The buffer's surface samples, under the material's normal map where it has one."""
    surface = buffer.samples(geometry)
    if frames is None or material is None or material.slopes is None:
        return surface
    return bent(surface, frames.at(geometry, buffer.face, buffer.bary), material.slopes)


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
