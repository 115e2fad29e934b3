"""What Monte Carlo light is computed for: surface points and their material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from exmesh_graph.geometry.adjacency import face_normals


@dataclass(frozen=True)
class Points:
    """N surface points; [N, 3], world space, unit vectors.

    flat    geometric normal, on the side the rays leave to
    normal  shading normal; where it looks away from a glossy point's viewer the light is 0 (`terminator.bend_normals`)
    view    towards the eye
    """

    position: torch.Tensor
    flat: torch.Tensor
    normal: torch.Tensor
    view: torch.Tensor

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, rows: slice | torch.Tensor) -> Points:
        return Points(self.position[rows], self.flat[rows], self.normal[rows], self.view[rows])


@dataclass(frozen=True)
class Material:
    """base_color [N, 3], linear; roughness [N] (None: no specular lobe); metallic [N] (None: dielectric)."""

    base_color: torch.Tensor
    roughness: torch.Tensor | None = None
    metallic: torch.Tensor | None = None

    def __getitem__(self, rows: slice | torch.Tensor) -> Material:
        parts = (self.base_color, self.roughness, self.metallic)
        return Material(*(None if part is None else part[rows] for part in parts))  # type: ignore[arg-type]

    def diffuse(self) -> torch.Tensor:
        """pi f_d = (1 - m) a, [N, 3]."""
        return self.base_color if self.metallic is None else self.base_color * (1 - self.metallic[:, None])


#: (face int64 [M], bary [M, 3]) -> the shading normal [M, 3] and the material there: the paper's attribute query.
Query = Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, Material]]


class Surface(Protocol):
    """The frozen mesh as tensors: vertices [V, 3], faces int64 [F, 3], unit face_normals [F, 3]."""

    vertices: torch.Tensor
    faces: torch.Tensor
    face_normals: torch.Tensor


class MeshSurface:
    """A Surface from arrays: vertices [V, 3], faces [F, 3]."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, device: torch.device | str = "cpu") -> None:
        self.vertices = torch.from_numpy(np.asarray(vertices, np.float32)).to(device)
        self.faces = torch.from_numpy(np.asarray(faces, np.int64)).to(device)
        self.face_normals = torch.from_numpy(face_normals(vertices, faces).astype(np.float32)).to(device)

    def at(self, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        """Positions [N, 3] of faces int64 [N] at barycentric coordinates [N, 3]."""
        return (self.vertices[self.faces[face]] * bary[..., None]).sum(1)
