"""The buffers of all training views under a memory budget, and what the views together know of each texel.

A view's buffer takes 20 to 200 ms to make and about 200 bytes per pixel on the object. The first views stay in memory
as far as the budget reaches; the others are made anew at each visit. (Views come in random order, each once a round:
keeping the last ones used would hit less often than keeping the same ones.) What is computed does not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import overload

import torch

from exmesh_graph.stage2.gbuffer import ViewBuffer, build_view
from exmesh_graph.stage2.light import LightModel
from exmesh_graph.stage2.surface import CarrierGeometry
from exmesh_graph.types import Views


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
        light: LightModel,
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
        for number in range(len(self)):
            buffer = self._build(number)
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
        self._row = torch.full((count,), -1, dtype=torch.int64, device=device)
        self._row[self.texels] = torch.arange(len(self.texels), device=device)
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
