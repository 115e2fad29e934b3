"""The visible face at each pixel centre on every core of a CPU: the launches of `kernels_cover` and their memory."""

from __future__ import annotations

from typing import NamedTuple

import torch

from exmesh_graph.gpu.cores import scratch, split
from exmesh_graph.gpu.simd import LANES
from exmesh_graph.raster.runtime import kernels


class Cover(NamedTuple):
    """What one view shows of F faces; contiguous CPU tensors.

    face_id  int32 [H, W], -1 on the background
    depth    float32 [H, W], camera z, 0 on the background
    boxes    int32 [F, 4], (first column, first row, last column, last row) of a face's centres; last < first for none
    shown    uint8 [F], 1 where a pixel shows the face
    """

    face_id: torch.Tensor
    depth: torch.Tensor
    boxes: torch.Tensor
    shown: torch.Tensor


def empty_cover(faces: int, height: int, width: int) -> Cover:
    """Memory for `cover`; a vector read from any pixel of `face_id` stays in it."""
    return Cover(
        torch.empty(height * width + LANES, dtype=torch.int32)[: height * width].view(height, width),
        torch.empty((height, width), dtype=torch.float32),
        torch.empty((faces, 4), dtype=torch.int32),
        torch.empty(faces, dtype=torch.uint8),
    )


def cover(
    points: torch.Tensor,
    faces: torch.Tensor,
    near: float,
    cull_back: bool,
    result: Cover,
    ground: tuple[torch.Tensor, torch.Tensor] | None = None,
) -> None:
    """Fill `result` from homogeneous pixel coordinates `points` float32 [V, 3] and `faces` int32 [F, 3].

    ground   float32 (alpha [H, W], colour [H, W, 3]) to fill with what is covered, 1 or 0, and with black
    """
    k = kernels("cover")
    height, width = result.face_id.shape
    if len(faces) == 0 or height * width == 0:
        result.face_id.fill_(-1)
        result.depth.zero_()
        for picture in ground or ():
            picture.zero_()
        return
    chunks, strips = -(-len(faces) // int(k.CHUNK)), -(-height // int(k.STRIP))
    tallies, places = (scratch(f"cover {name}", 2 * chunks * strips, torch.int32) for name in ("tallies", "places"))
    away = scratch("cover away", len(faces), torch.uint8)
    ends = scratch("cover ends", strips, torch.int32)
    _, _, boxes, shown = result
    split(
        k.sort_faces, chunks, len(faces), strips, height, width, near, points, faces, boxes, away, shown, tallies,
        grain=4,
    )  # fmt: skip
    lists = scratch("cover lists", int(tallies[: 2 * chunks * strips].sum()), torch.int32)
    split(k.list_faces, chunks, chunks, len(faces), strips, boxes, away, tallies, places, ends, lists, grain=4)
    split(
        k.cover_strips, strips, height, width, near, int(cull_back), int(ground is not None), points, faces, boxes,
        ends, lists, shown, result.face_id, result.depth, *(ground or (result.depth, result.depth)), grain=1,
    )  # fmt: skip
