"""Silhouette antialiasing by a scan over silhouette edges, with gradients to positions.

`edge_table` once per topology; `find_silhouette` per image (Warp); `antialias` blends colour and alpha together
(torch). Looking only at the edges of the faces under the pixels loses most of the gradient once faces shrink to a few
pixels; walking along the silhouette edges themselves does not (docs/rasteriser.md).

A pair is two horizontally or vertically neighbouring pixel centres with a silhouette edge between them, at
t in [0, 1] from the first; with s = t if the first is the near (surface) pixel and 1 - t otherwise,

    s > 1/2:  C_far  += w (s - 1/2) (C_near - C_far)          else  C_near += w (s - 1/2) (C_near - C_far)

with w = n_axis^2 / |n|^2 (n the edge's normal in the image, held constant), so that the horizontal and the vertical
pairs together move the covered area exactly as fast as the edge does.
"""

from __future__ import annotations

import math
import threading
from typing import NamedTuple

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.limits import EMPTY_KEY, check_near, check_size
from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.raster.rasterize import NEAR, Fragments
from exmesh_graph.raster.runtime import each_view, kernels

BEHIND = 5e-4
"""An edge must lie this share of its depth before the far pixel's surface: equal surfaces make no silhouette."""
IN_FRONT = 0.025
"""An edge nearer than the near pixel's surface by more than this share of its depth belongs to something thinner."""
REACH = 4.0
"""Cameras farther than this many diameters of the scene do not widen the two tolerances any more."""


class EdgeTable(NamedTuple):
    """Edges by shared vertex ids.

    edges     int32 [E, 2]
    opposite  int32 [E, 2], the third vertex of the faces on either side; -1 in the second place at a boundary
    """

    edges: torch.Tensor
    opposite: torch.Tensor


class Silhouette(NamedTuple):
    """Pixel pairs with a silhouette edge between them, P of them (of all views of a batch together).

    first, second  int64 [P], flat pixel indices of the [H, W] image or [N, H, W] batch;  second is right of or below
                   first
    ends           int64 [P, 2], the edge's vertices, rows of `projected` flattened to [-1, 3]
    vertical       bool [P], the pair is a vertical one
    near_first     bool [P], the surface lies on the first pixel's side
    """

    first: torch.Tensor
    second: torch.Tensor
    ends: torch.Tensor
    vertical: torch.Tensor
    near_first: torch.Tensor


def edge_table(faces: torch.Tensor) -> EdgeTable:
    """The edges of `faces` [F, 3] by vertex ids, so that UV seams do not show.

    A face that stands there twice counts once. An edge of k > 2 faces is listed once per consecutive pair of its
    faces: it may then count as a silhouette of one sheet in front of another, which the depth tests of
    `find_silhouette` sort out.
    """
    faces = faces.long()
    ends = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    third = torch.cat([faces[:, 2], faces[:, 0], faces[:, 1]])
    ends = ends.sort(dim=1).values
    if len(faces) == 0:
        empty = torch.zeros((0, 2), dtype=torch.int32, device=faces.device)
        return EdgeTable(empty, empty.clone())
    key = ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1]
    order = torch.argsort(third, stable=True)
    order = order[torch.argsort(key[order], stable=True)]
    key, ends, third = key[order], ends[order], third[order]
    twice = torch.cat([key.new_zeros(1, dtype=torch.bool), (key[1:] == key[:-1]) & (third[1:] == third[:-1])])
    key, ends, third = key[~twice], ends[~twice], third[~twice]
    same_as_next = torch.cat([key[1:] == key[:-1], key.new_zeros(1, dtype=torch.bool)])
    same_as_previous = torch.cat([key.new_zeros(1, dtype=torch.bool), key[1:] == key[:-1]])
    rows = torch.nonzero(same_as_next | ~same_as_previous)[:, 0]
    second = torch.where(same_as_next[rows], third[(rows + 1).clamp(max=len(third) - 1)], -1)
    opposite = torch.stack([third[rows], second], dim=1)
    keep = ends[rows, 0] != ends[rows, 1]
    return EdgeTable(ends[rows][keep].to(torch.int32).contiguous(), opposite[keep].to(torch.int32).contiguous())


def find_silhouette(
    projected: torch.Tensor,
    table: EdgeTable,
    fragments: Fragments,
    *,
    near: float = NEAR,
    extent: float = math.inf,
) -> Silhouette:
    """The pixel pairs whose colours the silhouette blends; of several edges between a pair the nearest counts.

    projected  [V, 3] or [N, V, 3] homogeneous pixel coordinates, those that made `fragments`
    extent     the scene's diameter in world units. `BEHIND` and `IN_FRONT` are shares of the depth, or of `REACH`
               diameters where that is less: seen from far through a long lens, depth says nothing of the scene's size

    An edge is a silhouette if it has one face or its two faces lie on the same side of it in the image. An edge that
    crosses the near plane takes part with the piece before it; the cut itself, which is no edge, does not.
    """
    check_near(near)
    height, width = fragments.face_id.shape[-2:]
    # a key's lower half holds 2 * edge + side; pairs are numbered 2 * pixel + direction
    check_size(**{"pixel pairs": 2 * height * width, "sides of edges": 2 * len(table.edges)})
    projected = projected.detach()
    places = projected.to(torch.float32).contiguous()
    limits = (near, BEHIND, IN_FRONT, min(REACH * extent, 1e30))
    count, parts = height * width, []
    for number, (points, face_id, depth) in enumerate(each_view(places, fragments.face_id, fragments.depth)):
        slots, code = _pairs(points, table, face_id, depth, limits)
        ends = table.edges.index_select(0, code >> 1).long() + number * projected.shape[-2]
        vertical = slots >= count
        first = torch.where(vertical, slots - count, slots)
        second = first + torch.where(vertical, width, 1)
        before = number * count  # pixels of the views before a pair's own
        parts.append(Silhouette(first + before, second + before, ends, vertical, (code & 1).bool()))
    return parts[0] if len(parts) == 1 else Silhouette(*map(torch.cat, zip(*parts, strict=True)))


def _pairs(
    points: torch.Tensor,
    table: EdgeTable,
    face_id: torch.Tensor,
    depth: torch.Tensor,
    limits: tuple[float, float, float, float],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Slots, ascending, and codes of one view's pairs, int64 [P], as the kernel `find_silhouette` numbers them."""
    k = kernels("silhouette")
    height, width = face_id.shape
    size, device = 2 * height * width, points.device
    marks = torch.zeros(len(table.edges), dtype=torch.bool, device=device)
    if len(marks) and size:
        split(k.mark_silhouette, len(marks), points, *table, limits[0], marks, grain=8192)
    listed = torch.nonzero(marks)[:, 0]
    if len(listed) == 0:
        return listed, listed
    # on a CPU the slots that are taken are listed and emptied again; elsewhere looking through all of them is cheap
    on_cpu = device.type == "cpu"
    # not in the key: room that is emptied again
    keys = _keys.empty(size) if on_cpu else torch.full((size,), EMPTY_KEY, dtype=torch.int64, device=device)
    found = torch.empty(_LISTED * (height + width) if on_cpu else 0, dtype=torch.int64, device=device)
    count = torch.zeros(1, dtype=torch.int32, device=device)
    launch(
        k.find_silhouette,
        len(listed),
        points,
        *table,
        listed,
        face_id,
        depth,
        height,
        width,
        *limits,
        keys,
        found,
        count,
    )
    if on_cpu and int(count) <= len(found):
        slots = found[: int(count)].sort().values
    else:
        slots = torch.nonzero(keys[:size] != EMPTY_KEY)[:, 0]
    code = keys.index_select(0, slots) & 0xFFFFFFFF
    if on_cpu:
        keys.index_fill_(0, slots, EMPTY_KEY)
    return slots, code


class _Keys(threading.local):
    """Memory for the keys of a view's pairs, which is empty between calls."""

    kept = torch.empty(0, dtype=torch.int64)

    def empty(self, size: int) -> torch.Tensor:
        if len(self.kept) < size:
            self.kept = torch.full((size,), EMPTY_KEY, dtype=torch.int64)
        return self.kept


_keys = _Keys()
_LISTED = 16
"""Pairs for each row and column of an image that are listed as they are found."""


def antialias(image: torch.Tensor, projected: torch.Tensor, silhouette: Silhouette) -> torch.Tensor:
    """Blend `image` [H, W, C] or [N, H, W, C] (colour and alpha together) along the silhouette; differentiable in both.

    projected  [V, 3] or [N, V, 3], those that `silhouette` was found with

    Values stay within those of the two pixels of each pair for a single pair; a pixel in several pairs may leave
    them slightly.
    """
    height, width, channels = image.shape[-3:]
    flat = image.reshape(-1, channels)
    t, weight = _crossing(projected.reshape(-1, 3), silhouette, height, width)
    s = torch.where(silhouette.near_first, t, 1 - t)
    near = torch.where(silhouette.near_first, silhouette.first, silhouette.second)
    far = torch.where(silhouette.near_first, silhouette.second, silhouette.first)
    difference = flat.index_select(0, near) - flat.index_select(0, far)
    change = (weight * (s - 0.5)).to(image.dtype)[:, None] * difference
    target = torch.where(s > 0.5, far, near)
    return flat.index_add(0, target, change).view(image.shape)


def _crossing(
    projected: torch.Tensor, silhouette: Silhouette, height: int, width: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """(t, w): where the edge crosses between the two centres, and the squared normal component along the pair."""
    x = (silhouette.first % width).to(projected.dtype) + 0.5
    y = (silhouette.first // width % max(height, 1)).to(projected.dtype) + 0.5
    a = projected.index_select(0, silhouette.ends[:, 0])
    b = projected.index_select(0, silhouette.ends[:, 1])
    # the image line through both ends, relative to the first centre: l = a' x b', l . (X, Y, 1) = 0
    ax, ay, az = a[:, 0] - x * a[:, 2], a[:, 1] - y * a[:, 2], a[:, 2]
    bx, by, bz = b[:, 0] - x * b[:, 2], b[:, 1] - y * b[:, 2], b[:, 2]
    normal_x, normal_y = ay * bz - az * by, az * bx - ax * bz
    along = torch.where(silhouette.vertical, normal_y, normal_x)
    t = -(ax * by - ay * bx) / along
    with torch.no_grad():
        weight = along.square() / (normal_x.square() + normal_y.square())
    return t, weight
