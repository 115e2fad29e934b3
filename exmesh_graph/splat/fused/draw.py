"""Gaussians drawn and differentiated by native kernels: float32 on a CPU. `render.render` is the way in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.gpu.limits import check_size
from exmesh_graph.gpu.warp_runtime import launch, warp
from exmesh_graph.splat.fused.native_eight import RECORD
from exmesh_graph.splat.gaussians import Gaussians


class Camera(NamedTuple):
    """numbers: float32 [21], rotation, shift, the first two rows of K, and the eye; `near` in world units, the degree
    of the harmonics in use, or -1 for a drawing without colours; `tile` in pixels."""

    numbers: torch.Tensor
    height: int
    width: int
    near: float
    degree: int
    tile: int


class Memory:
    """Buffers of one drawing at a time, kept for the next: fresh memory is paged in at every step (`cores.scratch`)."""

    def __init__(self) -> None:
        self._kept: dict[str, torch.Tensor] = {}

    def take(self, name: str, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Contiguous, not cleared; valid until the name is taken again."""
        size = math.prod(shape)
        if name not in self._kept:
            self._kept[name] = torch.empty(size, dtype=dtype)
        elif len(self._kept[name]) < size:
            self._kept[name] = torch.empty(size + size // 4, dtype=dtype)
        return self._kept[name][:size].view(shape)


class Planes(NamedTuple):
    """Contiguous pictures: colour [H, W, 3], alpha [H, W], normal [H, W, 3], distance [H, W]."""

    colour: torch.Tensor
    alpha: torch.Tensor
    normal: torch.Tensor
    distance: torch.Tensor


@dataclass
class Seen:
    """What a drawing says of each Gaussian besides: box int32 [G, 4], weight [G] and middle int32 [H, W] of
    `render.DrawnGaussians`."""

    box: torch.Tensor
    weight: torch.Tensor
    middle: torch.Tensor


class _Lists(NamedTuple):
    """first int32 [G + 1], a Gaussian's first slot (one for each tile that it touches); start int32 [tiles + 1], a
    tile's first entry; entries int32 [slots, 2], slot and Gaussian, by tile and depth; `weights` [slots]."""

    first: torch.Tensor
    start: torch.Tensor
    entries: torch.Tensor
    weights: torch.Tensor
    tile: int
    across: int


class Drawing:
    """A picture of Gaussians, and what the way back needs; where `memory` is given, until it is given to another."""

    def __init__(self, gaussians: Gaussians, camera: Camera, most_pairs: int, memory: Memory | None = None) -> None:
        memory = memory or Memory()
        count, height, width = len(gaussians), camera.height, camera.width
        self.gaussians, self.camera = gaussians, camera
        self.planes = Planes(
            memory.take("colour", height, width, 3), memory.take("alpha", height, width),
            memory.take("normal", height, width, 3), memory.take("distance", height, width),
        )  # fmt: skip
        self.seen = Seen(
            memory.take("box", count, 4, dtype=torch.int32), memory.take("weight", count),
            memory.take("middle", height, width, dtype=torch.int32),
        )  # fmt: skip
        self.thick = torch.zeros(self.blocks, 2, dtype=torch.float64)
        self.lists: _Lists | None = None
        if not (count and height and width):
            self._nothing()
            return
        k = _kernels()
        self.records = memory.take("records", -(-count // 8) * 8, RECORD)
        depth, touched = scratch("splat depths", count)[:count], scratch("splat tiles", count, torch.int32)[:count]
        split(
            k.project, self.blocks, count, *gaussians.tensors().values(), gaussians.sh.shape[1], max(camera.degree, 0),
            int(camera.degree >= 0), camera.numbers, height, width, camera.near, camera.tile, self.records,
            self.seen.box, depth, touched, grain=4,
        )  # fmt: skip
        lists = self.lists = _listed(self.seen.box, depth, touched, camera, most_pairs, memory)
        if not len(lists.entries):
            self._nothing()
            return
        self.left = memory.take("left", height, width)
        self.last = memory.take("last", height, width, dtype=torch.int32)
        split(
            k.blend, len(lists.start) - 1, *self._tiles(), int(camera.degree >= 0), *self.planes, self.left, self.last,
            self.seen.middle, lists.weights, grain=1,
        )  # fmt: skip
        split(
            k.sum_slots, self.blocks, count, lists.first, lists.weights, gaussians.scales, self.seen.weight, self.thick,
            grain=16,
        )  # fmt: skip

    def _nothing(self) -> None:
        for plane in self.planes:
            plane.zero_()
        self.seen.box[:] = torch.tensor([0, 0, -1, 0], dtype=torch.int32)
        self.seen.weight.zero_()
        self.seen.middle.fill_(-1)

    @property
    def blocks(self) -> int:
        return -(-len(self.gaussians) // int(_kernels().GAUSSIANS))

    def _tiles(self) -> tuple[Any, ...]:
        assert self.lists is not None
        lists, camera = self.lists, self.camera
        tiles = len(lists.start) - 1
        spread = max(1, round(0.382 * tiles))  # the golden section: no run of items is a region of the picture
        while math.gcd(spread, tiles) > 1:
            spread += 1
        return (
            tiles, spread, lists.start, lists.entries, self.records, self.seen.box, lists.tile, lists.across,
            camera.height, camera.width,
        )  # fmt: skip

    def back(self, to: Planes, on_screen: torch.Tensor) -> Gaussians:
        """dL/d of every parameter for dL/d of the planes (contiguous), 0 where not seen; fills `on_screen` [G, 2] as
        `DrawnGaussians.gradient`."""
        gradients = self.gaussians.map(torch.empty_like)
        if not self._carry(_adjoint().gradients, to, 0.0, *gradients.tensors().values(), on_screen):
            on_screen.zero_()
            return self.gaussians.map(torch.zeros_like)
        return gradients

    def step(self, to: Planes, thin: float, *state: Any) -> None:
        """A step of Adam for dL/d of the planes (contiguous), plus `thin` for dL/d of each thickness that is seen;
        `state` is what `kernels_adjoint.adam_step` takes from the moments on."""
        self._carry(_adjoint().adam_step, to, thin, *state)

    def thickness(self) -> tuple[int, float]:
        """How many Gaussians are seen, and the mean of their smallest standard deviations."""
        count, total = self.thick.sum(0).tolist()
        return int(count), total / max(count, 1)

    def _carry(self, end: Any, to: Planes, thin: float, *rest: Any) -> bool:
        """The way back, up to what `end` makes of it; False where nothing was drawn."""
        lists, gaussians, camera = self.lists, self.gaussians, self.camera
        if lists is None or not len(lists.entries):
            return False
        slots = scratch("splat slots", len(lists.entries) * RECORD)
        split(
            _adjoint().blend_adjoint, len(lists.start) - 1, *self._tiles(), lists.weights, self.left, self.last, *to,
            slots, grain=1,
        )  # fmt: skip
        split(
            end, self.blocks, len(gaussians), lists.first, lists.weights, slots, self.seen.weight, self.records, thin,
            *gaussians.tensors().values(), gaussians.sh.shape[1], camera.degree, camera.numbers, camera.height,
            camera.width, *rest, grain=4,
        )  # fmt: skip
        return True


class Splat(torch.autograd.Function):
    """`Drawing` for autograd: the parameters of the Gaussians to the four planes; `drawn` is filled."""

    @staticmethod
    def forward(ctx: Any, means, scales, rotations, opacities, sh, camera, most_pairs, drawn):  # type: ignore[no-untyped-def]
        tensors = (t.detach().contiguous() for t in (means, scales, rotations, opacities, sh))
        ctx.drawing = drawing = Drawing(Gaussians(*tensors), camera, most_pairs)
        drawn.box, drawn.weight, drawn.middle = drawing.seen.box, drawing.seen.weight, drawing.seen.middle
        ctx.drawn = drawn
        return tuple(drawing.planes)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *to):  # type: ignore[no-untyped-def]
        gradients = ctx.drawing.back(Planes(*(t.contiguous() for t in to)), ctx.drawn.gradient)
        return *gradients.tensors().values(), None, None, None


def numbers(intrinsics: torch.Tensor, world_to_camera: torch.Tensor) -> torch.Tensor:
    """float64 [21] of a camera's [3, 3] and [4, 4]: `Camera.numbers`."""
    pose, matrix = world_to_camera.double(), intrinsics.double()
    rotation, shift = pose[:3, :3], pose[:3, 3]
    return torch.cat([rotation.reshape(-1), shift, matrix[:2].reshape(-1), -rotation.T @ shift])


def _listed(
    box: torch.Tensor, depth: torch.Tensor, touched: torch.Tensor, camera: Camera, most_pairs: int, memory: Memory
) -> _Lists:
    """Tiles are enlarged until there are at most `most_pairs` slots, or one tile is all."""
    k, tile, count = _kernels(), camera.tile, len(box)
    while int(touched.sum(dtype=torch.int64)) > most_pairs and tile < max(camera.height, camera.width):
        tile *= 2
        low, high = (torch.div(corner, tile, rounding_mode="floor") for corner in (box[:, :2], box[:, 2:]))
        touched = torch.where(box[:, 2] >= box[:, 0], (high - low + 1).prod(dim=1), 0)
    total = int(touched.sum(dtype=torch.int64))
    check_size(**{"pairs of Gaussians and tiles": total})
    first = memory.take("first", count + 1, dtype=torch.int32)
    first[0] = 0
    torch.cumsum(touched, 0, dtype=torch.int32, out=first[1:])
    across, down = -(-camera.width // tile), -(-camera.height // tile)
    start = memory.take("start", across * down + 1, dtype=torch.int32)
    entries, weights = memory.take("entries", total, 2, dtype=torch.int32), memory.take("weights", total).zero_()
    if total:
        tile_of = scratch("splat tile", total, torch.int32)
        split(k.list_tiles, -(-count // int(k.GAUSSIANS)), count, box, first, tile, across, tile_of, grain=16)
        spare = scratch("splat sort", 4 * count + across * down, torch.int32)
        launch(k.sort_slots, 1, count, total, across * down, depth, first, tile_of, spare, start, entries)
    return _Lists(first, start, entries, weights, tile, across)


@cache
def _kernels() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.splat.fused import kernels_draw

    return kernels_draw


@cache
def _adjoint() -> Any:
    """Imported after Warp has been set up."""
    warp()
    from exmesh_graph.splat.fused import kernels_adjoint

    return kernels_adjoint
