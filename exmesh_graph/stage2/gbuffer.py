"""What each training pixel of a view sees: the primary hits of a frozen mesh never change.

`stage2.stream` keeps the buffers of all views, or makes them anew when memory is short.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.losses import SsimTarget
from exmesh_graph.raster import rasterize
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples, texel_footprint
from exmesh_graph.types import Views

if TYPE_CHECKING:
    from exmesh_graph.stage2.light import LightModel


#: Three planes of three float32 channels for each pixel of a view's box (losses.SsimTarget).
SSIM_BYTES = 36


@dataclass
class ViewBuffer:
    """One training view on the carrier: N pixels whose centre meets the mesh inside the object's mask.

    number, name  of the view
    pixel         int64 [N], row-major
    target        [N, 3], linear straight colour;  clipped bool [N, 3]: at the top of an 8-bit file's range
    coverage      [N], the mask's alpha, the pixel's weight in the loss
    face, bary    [N], [N, 3]
    texel, texel_weight   [N, 4], rows of the fit's compact texel table (stage2.stream)
    n_v           [N]
    pairs         int64 [Q, 2], neighbouring pixels (by row of this buffer) on one continuous surface
    light         what the light model keeps of the view (LightModel.view)
    box, box_pixel        height and width of the pixels' bounding box, and their flat positions in it
    ssim                  statistics of the target for D-SSIM, made when first asked for
    """

    number: int
    name: str
    pixel: torch.Tensor
    target: torch.Tensor
    clipped: torch.Tensor
    coverage: torch.Tensor
    face: torch.Tensor
    bary: torch.Tensor
    texel: torch.Tensor
    texel_weight: torch.Tensor
    n_v: torch.Tensor
    pairs: torch.Tensor
    camera: torch.Tensor
    light: Any
    box: tuple[int, int]
    box_pixel: torch.Tensor
    ssim: SsimTarget | None = None

    def samples(self, geometry: CarrierGeometry) -> SurfaceSamples:
        """The buffer's surface samples, rebuilt."""
        return geometry.samples(self.face, self.bary, self.camera)

    def bytes(self) -> int:
        """Bytes of all tensors, and of those that D-SSIM will add."""
        held = [vars(self), vars(self.light)] if hasattr(self.light, "__dict__") else [vars(self)]
        tensors = [value for values in held for value in values.values() if isinstance(value, torch.Tensor)]
        return sum(t.element_size() * t.numel() for t in tensors) + SSIM_BYTES * self.box[0] * self.box[1]


def build_view(
    geometry: CarrierGeometry, light: LightModel, views: Views, number: int, size: int, min_coverage: float
) -> ViewBuffer:
    """The buffer of one view, its `texel` indices flat positions in size x size maps.

    Pixels with alpha below `min_coverage` are left out. The same bytes whenever it is called.
    """
    device = geometry.device
    height, width = views.height, views.width
    fragments = rasterize(
        geometry.vertices,
        geometry.faces.to(torch.int32),
        tensor_of(views.intrinsics[number]).to(device),
        torch.from_numpy(views.world_to_camera[number]).to(device),
        height,
        width,
    )
    alpha = tensor_of(views.alpha[number]).to(device)
    inside = (fragments.face_id >= 0) & (alpha >= min_coverage)
    pixel = torch.nonzero(inside.reshape(-1))[:, 0]
    face = fragments.face_id.reshape(-1)[pixel].long()
    bary = fragments.bary.reshape(-1, 3)[pixel]
    camera = torch.from_numpy(views.camera_to_world[number][:3, 3].astype(np.float32)).to(device)
    samples = geometry.samples(face, bary, camera)
    coverage = alpha.reshape(-1)[pixel]
    target = tensor_of(views.images[number]).to(device).reshape(-1, 3)[pixel] / coverage[:, None]
    texel, texel_weight = texel_footprint(samples.uv, size)
    box, box_pixel = _box(pixel, width)
    return ViewBuffer(
        number=number,
        name=views.names[number],
        pixel=pixel,
        target=target,
        clipped=(target >= 1 - 1 / 512) if views.clipped else torch.zeros_like(target, dtype=torch.bool),
        coverage=coverage,
        face=face,
        bary=bary,
        texel=texel,
        texel_weight=texel_weight,
        n_v=samples.n_v,
        pairs=_pairs(inside, samples, pixel),
        camera=camera,
        light=light.view(samples, pixel, width, number),
        box=box,
        box_pixel=box_pixel,
    )


def _box(pixel: torch.Tensor, width: int) -> tuple[tuple[int, int], torch.Tensor]:
    """Size of the bounding box of flat `pixel`s and their flat positions inside it."""
    if len(pixel) == 0:
        return (0, 0), pixel
    row, column = pixel // width, pixel % width
    row, column = row - row.min(), column - column.min()
    box = (int(row.max()) + 1, int(column.max()) + 1)
    return box, row * box[1] + column


def _pairs(inside: torch.Tensor, samples: SurfaceSamples, pixel: torch.Tensor) -> torch.Tensor:
    """Horizontal and vertical neighbours that lie on one surface: the step between them stays near both tangent
    planes (a jump in depth is no neighbourhood of the material)."""
    height, width = inside.shape
    row = torch.full((height * width,), -1, dtype=torch.int64, device=inside.device)
    row[pixel] = torch.arange(len(pixel), device=inside.device)
    grid = row.reshape(height, width)
    across = torch.stack([grid[:, :-1].reshape(-1), grid[:, 1:].reshape(-1)], 1)
    down = torch.stack([grid[:-1].reshape(-1), grid[1:].reshape(-1)], 1)
    pairs = torch.cat([across, down])
    pairs = pairs[(pairs >= 0).all(1)]
    step = samples.position[pairs[:, 0]] - samples.position[pairs[:, 1]]
    length = step.norm(dim=-1).clamp_min(1e-12)
    slope = torch.maximum(
        (step * samples.flat[pairs[:, 0]]).sum(-1).abs(), (step * samples.flat[pairs[:, 1]]).sum(-1).abs()
    )
    return pairs[slope < 0.5 * length]
