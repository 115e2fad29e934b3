"""Colours of texels (the paper's T_rgb), vertices or faces, and how a model without a texture is drawn and baked."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from exmesh_graph.raster import barycentrics, shade
from exmesh_graph.stage1.appearance.model import AppearanceModel, Surface
from exmesh_graph.uv.raster import dilate, rasterize_atlas
from exmesh_graph.uv.transfer import COVER

_CHUNK = 1 << 16


class UVTexture(AppearanceModel):
    """Texels [R, R, 3], read bilinearly."""

    def shade(self, surface: Surface, projected: torch.Tensor, face_id: torch.Tensor) -> torch.Tensor:
        return shade(projected, surface.faces, surface.uvs, surface.uv_faces, self.values, face_id)

    def fields(self, surface: Surface, size: int, fill: bool) -> dict[str, Any]:
        from exmesh_graph.stage1.init import fill_unseen

        kept = self.arrays()
        if fill:
            kept["values"] = fill_unseen(self.values.detach(), self.touched).cpu().numpy()
        return {"texture": kept["values"], "texture_m": kept["m"], "texture_v": kept["v"]}


class SurfaceModel(AppearanceModel):
    """A model that knows the colour of a point of the surface, given by its face and place in it."""

    def at(self, surface: Surface, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        """Colours [P, 3] at the barycentric coordinates `bary` [P, 3] in the faces `face` int64 [P]."""
        raise NotImplementedError

    def shade(self, surface: Surface, projected: torch.Tensor, face_id: torch.Tensor) -> torch.Tensor:
        flat = face_id.reshape(-1)
        pixels = torch.nonzero(flat >= 0)[:, 0]
        face = flat[pixels].long()
        colour = self.at(surface, face, barycentrics(projected, surface.faces, face, pixels, face_id.shape[-1]))
        out = colour.new_zeros((len(flat), 3))
        return out.index_copy(0, pixels, colour).view(*face_id.shape, 3)

    def fields(self, surface: Surface, size: int, fill: bool) -> dict[str, Any]:
        return {"model": self.arrays(), "texture": self.bake(surface, size)}

    @torch.no_grad()
    def bake(self, surface: Surface, size: int) -> np.ndarray:
        """The texture float32 [size, size, 3] that shows the model, filled to the last texel."""
        face_id, bary = rasterize_atlas(surface.uvs.cpu().numpy(), surface.uv_faces.cpu().numpy(), size, margin=COVER)
        covered = face_id >= 0
        places = zip(*(torch.from_numpy(a[covered]).split(_CHUNK) for a in (face_id, bary)), strict=True)
        device = self.values.device
        texture = np.full((size, size, 3), 0.5, np.float32)
        parts = [self.at(surface, face.long().to(device), at.to(device)).cpu().numpy() for face, at in places]
        if parts:
            texture[covered] = np.concatenate(parts)
        return dilate(np.clip(texture, 0, 1), covered)


class PerVertex(SurfaceModel):
    """Colours [V, 3], interpolated over the faces."""

    def at(self, surface: Surface, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        corners = self.values.index_select(0, surface.faces.long()[face].reshape(-1)).view(-1, 3, 3)
        return (bary[..., None] * corners).sum(1)


class PerFace(SurfaceModel):
    """Colours [F, 3], one for each face: colour then moves no vertex inside the silhouette."""

    def at(self, surface: Surface, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        return self.values.index_select(0, face)
