"""What each training pixel of a view sees (the primary hits of a frozen mesh never change), and of all views together.

A view's buffer takes 20 to 200 ms to make and about 200 bytes per pixel on the object. The first views stay in memory
as far as the budget reaches; the others are made anew at each visit. (Views come in random order, each once a round:
keeping the last ones used would hit less often than keeping the same ones.) What is computed does not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, overload

import numpy as np
import torch

from exmesh_graph.gpu.cores import shared
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.losses import SSIM_WINDOW, SsimTarget
from exmesh_graph.raster import rasterize
from exmesh_graph.stage2.maps import Footprint
from exmesh_graph.stage2.surface import CarrierGeometry, SurfaceSamples, texel_footprint
from exmesh_graph.types import Views

#: Three planes of three float32 channels for each pixel of a view's box (losses.SsimTarget).
SSIM_BYTES = 36
#: `ViewBuffer.footprint.order` and `neighbours` of a pixel.
FUSED_BYTES = 20

_OF_PIXELS = (
    "pixel", "target", "clipped", "coverage", "face", "bary", "texel", "texel_weight", "n_v", "box_pixel",
)  # fmt: skip


@dataclass
class ViewBuffer:
    """One training view on the carrier: N pixels whose centre meets the mesh inside the object's mask.

    number, name  of the view
    pixel         int64 [N], row-major
    target        [N, 3], linear straight colour;  clipped bool [N, 3]: at the top of an 8-bit file's range
    coverage      [N], the mask's alpha, the pixel's weight in the loss
    face, bary    [N], [N, 3]
    texel, texel_weight   int32 [N, 4], [N, 4]: rows of the fit's compact texel table (ViewBuffers.texels)
    n_v           [N]
    pairs         int32 [Q, 2], neighbouring pixels (by row of this buffer) on one continuous surface
    light         what the light model keeps of the view (LightModel.view)
    box, box_pixel        height and width of a box around the pixels, SSIM's half window wider, and their places in it
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

    @cached_property
    def footprint(self) -> Footprint:
        """Texels and weights, in the order that the fused step's adjoint wants."""
        return Footprint.of(self.texel, self.texel_weight)

    @cached_property
    def neighbours(self) -> torch.Tensor:
        """The pixels to the left, right, above and below, int32 [N, 4], by `pairs`; the pixel itself where none is."""
        itself = torch.arange(len(self.pixel), dtype=torch.int32, device=self.pixel.device)
        found = itself[:, None].repeat(1, 4)
        first, second = self.pairs.long().unbind(1)
        across = self.pixel[second] - self.pixel[first] == 1
        for chosen, side in ((across, 0), (~across, 2)):
            found[second[chosen], side] = self.pairs[chosen, 0]
            found[first[chosen], side + 1] = self.pairs[chosen, 1]
        return found

    def at(self, rows: torch.Tensor) -> ViewBuffer:
        """The buffer of some of its pixels, which have no neighbours in it."""
        some = {name: getattr(self, name)[rows] for name in _OF_PIXELS}
        return replace(self, **some, pairs=self.pairs[:0], light=self.light.at(rows), ssim=None)

    def crossings(self, every: int) -> torch.Tensor:
        """Which pixels lie in every n-th row and column, bool [N]."""
        width = self.box[1]
        return ((self.box_pixel // width) % every == 0) & ((self.box_pixel % width) % every == 0)

    def samples(self, geometry: CarrierGeometry) -> SurfaceSamples:
        """The buffer's surface samples, rebuilt."""
        return geometry.samples(self.face, self.bary, self.camera)

    def bytes(self) -> int:
        """Bytes of all tensors, and of those that D-SSIM and the fused step will add."""
        held = [vars(self), vars(self.light)] if hasattr(self.light, "__dict__") else [vars(self)]
        tensors = [value for values in held for value in values.values() if isinstance(value, torch.Tensor)]
        return (
            sum(t.element_size() * t.numel() for t in tensors)
            + SSIM_BYTES * self.box[0] * self.box[1]
            + FUSED_BYTES * len(self.pixel)
        )


class ViewLight(Protocol):
    """The part of a light model (stage2.light.model) that views' buffers are made with."""

    def texels(self, size: int) -> torch.Tensor:
        """Flat texels int64 [any] of size x size maps that the model itself reads, besides those of pixels."""

    def view(self, surface: SurfaceSamples, pixel: torch.Tensor, width: int, number: int) -> Any:
        """What the model keeps of view `number`: `surface` seen by its flat `pixel`s in an image `width` wide.

        Called again whenever a view's buffer had to go from memory: what the model measures lives in the model, by the
        view's number.
        """


def build_view(
    geometry: CarrierGeometry, light: ViewLight, views: Views, number: int, size: int, min_coverage: float
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
    """Size of the box around flat `pixel`s that holds every window of SSIM with one of them; their places in it."""
    if len(pixel) == 0:
        return (0, 0), pixel
    row, column = pixel // width, pixel % width
    margin = SSIM_WINDOW // 2
    row, column = row - row.min() + margin, column - column.min() + margin
    box = (int(row.max()) + 1 + margin, int(column.max()) + 1 + margin)
    return box, row * box[1] + column


def _pairs(inside: torch.Tensor, samples: SurfaceSamples, pixel: torch.Tensor) -> torch.Tensor:
    """Horizontal and vertical neighbours that lie on one surface."""
    height, width = inside.shape
    row = torch.full((height * width,), -1, dtype=torch.int32, device=inside.device)
    row[pixel] = torch.arange(len(pixel), dtype=torch.int32, device=inside.device)
    grid = row.reshape(height, width)
    across = torch.stack([grid[:, :-1].reshape(-1), grid[:, 1:].reshape(-1)], 1)
    down = torch.stack([grid[:-1].reshape(-1), grid[1:].reshape(-1)], 1)
    pairs = torch.cat([across, down])
    pairs = pairs[(pairs >= 0).all(1)]
    return pairs[samples.joined(pairs[:, 0], pairs[:, 1])]


@dataclass(frozen=True)
class Evidence:
    """What the training views know of each of T texels, float32 [T].

    weight  bilinear weight over all pixels of all views: about how many pixels the texel fills
    cosine  mean cosine between normal and view, over those pixels
    views   number of views that see the texel with a weight of at least 0.01
    """

    weight: torch.Tensor
    cosine: torch.Tensor
    views: torch.Tensor


class ViewBuffers(Sequence[ViewBuffer]):
    """The ViewBuffers of `views`, in their order.

    texels    int64 [T], ascending: flat positions in size x size maps that a view or the light reads; the buffers'
              `texel` are rows of this table
    evidence  of those texels
    faults    view number -> why its photograph cannot be used; such a view is empty
    pixels    number of pixels of each buffer, sizes: bytes;  held: those that stay in memory
    """

    def __init__(
        self,
        geometry: CarrierGeometry,
        light: ViewLight,
        views: Views,
        size: int,
        min_coverage: float,
        budget: float = math.inf,
    ) -> None:
        self.geometry, self.light, self.views, self.size = geometry, light, views, size
        self.min_coverage, self.budget = min_coverage, budget
        self.faults: dict[int, str] = {}
        self.pixels: list[int] = []
        self.sizes: list[int] = []
        self._held: dict[int, ViewBuffer] = {}
        self._row: torch.Tensor | None = None
        self._survey()

    @property
    def held(self) -> list[ViewBuffer]:
        return list(self._held.values())

    def __len__(self) -> int:
        return len(self.views)

    @overload
    def __getitem__(self, index: int) -> ViewBuffer: ...
    @overload
    def __getitem__(self, index: slice) -> list[ViewBuffer]: ...
    def __getitem__(self, index: int | slice) -> ViewBuffer | list[ViewBuffer]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        if number not in self._held:
            return self._compact(self._build(number))
        return self._held[number]

    def leave_out(self, number: int, reason: str) -> None:
        """Make a view empty from now on."""
        self.faults[number] = reason
        if number in self._held:
            self._held[number] = self._compact(self._build(number))

    def _survey(self) -> None:
        """One pass over all views: the texels they read, what they know of them, which photographs are broken."""
        count = self.size * self.size
        device = self.geometry.device
        used = torch.zeros(count, dtype=torch.bool, device=device)
        used[self.light.texels(self.size)] = True
        weight, cosine, seen = (torch.zeros(count, device=device) for _ in range(3))
        held = 0
        for number, buffer in enumerate(shared(self._build, range(len(self)))):
            self.pixels.append(len(buffer.pixel))
            fault = _fault(buffer, self.views.width)
            if fault:
                self.faults[number] = fault
                buffer = self._build(number)
            texel, share = buffer.texel.reshape(-1), buffer.texel_weight.reshape(-1)
            used[texel] = True
            here = torch.zeros(count, device=device).index_add_(0, texel, share)
            weight += here
            seen += here >= 0.01
            cosine.index_add_(0, texel, share * buffer.n_v.repeat_interleave(4))
            self.sizes.append(buffer.bytes())
            held += self.sizes[-1]
            if held <= self.budget:
                self._held[number] = buffer
        self.texels = torch.nonzero(used)[:, 0]
        self._row = torch.full((count,), -1, dtype=torch.int32, device=device)
        self._row[self.texels] = torch.arange(len(self.texels), dtype=torch.int32, device=device)
        cosine /= weight.clamp_min(1e-12)
        self.evidence = Evidence(weight[self.texels], cosine[self.texels], seen[self.texels])
        for number, buffer in self._held.items():
            self._held[number] = self._compact(buffer)

    def _build(self, number: int) -> ViewBuffer:
        # no alpha reaches infinity: an empty buffer of the right types
        least = math.inf if number in self.faults else self.min_coverage
        return build_view(self.geometry, self.light, self.views, number, self.size, least)

    def _compact(self, buffer: ViewBuffer) -> ViewBuffer:
        assert self._row is not None
        return replace(buffer, texel=self._row[buffer.texel])


def _fault(buffer: ViewBuffer, width: int) -> str:
    """Why a photograph cannot be used, "" when it can."""
    broken = ~torch.isfinite(buffer.target).all(dim=1)
    if not bool(broken.any()):
        return ""
    first = int(buffer.pixel[broken][0])
    return (
        f"{int(broken.sum())} pixels of its image are NaN or Inf, the first at column {first % width}, "
        f"row {first // width}"
    )
