"""The paper's appearance T_rgb: a texture over the UV atlas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

from exmesh_graph.raster import shade
from exmesh_graph.stage1.appearance.model import Model

if TYPE_CHECKING:
    from exmesh_graph.stage1.render import Surface


class UVTexture(Model):
    """Texels [R, R, 3], read bilinearly."""

    def shade(self, surface: Surface, projected: torch.Tensor, face_id: torch.Tensor) -> torch.Tensor:
        return shade(projected, surface.faces, surface.uvs, surface.uv_faces, self.values, face_id)

    def fields(self, surface: Surface, size: int, fill: bool) -> dict[str, Any]:
        from exmesh_graph.stage1.init import fill_unseen

        found = self.arrays()
        if fill:
            found["values"] = fill_unseen(self.values.detach(), self.touched).cpu().numpy()
        return {"texture": found["values"], "texture_m": found["m"], "texture_v": found["v"]}
