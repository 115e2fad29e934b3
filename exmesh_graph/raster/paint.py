"""A textured picture with antialiased outlines in one operation, on every core of a CPU.

The plain form is `rasterize_projected`, `shade`, `find_silhouette` and `antialias` in turn (`stage1.render.draw`): the
same picture and the same gradients, to rounding. Here each pass walks the faces that the view shows, nothing is
written that another item of the same launch writes, and all memory is kept from picture to picture.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.limits import check_indices, check_size
from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.raster.cover import cover, empty_cover
from exmesh_graph.raster.rasterize import NEAR, Fragments
from exmesh_graph.raster.runtime import kernels
from exmesh_graph.raster.silhouette import EdgeTable, find_silhouette

_MARGIN = 0.01
"""Texels by which rounding may move a place in the atlas off its face."""

_NOTHING = torch.empty((0, 3))


class Painter:
    """Paints one topology at one size, on a CPU in float32.

    A picture is valid until the next one is painted, and a texture's gradient until the next is asked for.

    faces, uv_faces   int32 [F, 3];  uvs float32 [T, 2];  edges, the mesh's
    vertices          how many there are
    texels            (rows, columns) of the textures, two at least
    height, width     of the pictures
    """

    def __init__(
        self,
        faces: torch.Tensor,
        uvs: torch.Tensor,
        uv_faces: torch.Tensor,
        edges: EdgeTable,
        *,
        vertices: int,
        texels: tuple[int, int],
        height: int,
        width: int,
    ) -> None:
        if min(texels) < 2:
            raise ValueError(
                f"a texture of {texels[0]} x {texels[1]} texels has no neighbours to blend: 2 x 2 at least"
            )
        check_size(colours=3 * height * width, texels=3 * texels[0] * texels[1], corners=9 * len(faces))
        self.faces, self.uvs, self.uv_faces, self.edges = faces.contiguous(), uvs.contiguous(), uv_faces, edges
        check_indices("faces", faces, vertices)
        check_indices("uv_faces", uv_faces, len(uvs))
        self.texels = texels
        self.cover = empty_cover(len(faces), height, width)
        self.colour = torch.empty((height, width, 3))
        self.alpha = torch.empty((height, width))
        self.by_texture = torch.empty((*texels, 3))
        self.by_face, self.by_tint = (torch.empty((len(faces), 3, 3)) for _ in range(2))
        corner = faces.reshape(-1).long().numpy()
        self.corners = torch.from_numpy(np.argsort(corner, kind="stable").astype(np.int32))
        self.corner_starts = _starts(corner, vertices)
        self.band_starts, self.band_faces = _bands(uvs, uv_faces, texels[0])

    def paint(
        self,
        projected: torch.Tensor,
        texture: torch.Tensor,
        tints: torch.Tensor | None = None,
        *,
        extent: float = math.inf,
        uv_gradient: bool = True,
    ) -> tuple[torch.Tensor, torch.Tensor, Fragments]:
        """Colour [H, W, 3], coverage [H, W], both blended along the silhouette, and what each pixel shows.

        `tints` [V, 3] are interpolated over the faces and added to the texture's colour. Differentiable in `projected`
        [V, 3], homogeneous pixel coordinates, `texture` [R, S, 3] and `tints`; without `uv_gradient` colour moves no
        vertices but through the outline. `extent` as in `find_silhouette`. The fragments
        have no barycentric coordinates.
        """
        tints = _NOTHING if tints is None else tints
        if len(tints) not in (0, len(projected)):
            raise ValueError(f"{len(tints)} tints for {len(projected)} vertices: one for each, or none")
        colour, alpha = _Paint.apply(projected, texture, tints, self, extent, uv_gradient)
        return colour, alpha, Fragments(self.cover.face_id, torch.empty(0), self.cover.depth)


class _Paint(torch.autograd.Function):
    @staticmethod
    def forward(ctx, projected, texture, tints, painter, extent, uv_gradient):
        k, (rows, columns) = kernels("paint"), painter.texels
        points, texture = projected.detach().contiguous(), texture.detach().contiguous()
        tints = tints.detach().contiguous()
        count, width = len(painter.faces), painter.alpha.shape[1]
        seen, colour, alpha = painter.cover, painter.colour, painter.alpha
        cover(points, painter.faces, NEAR, False, seen, (alpha, colour))
        atlas = (points, painter.faces, painter.uvs, painter.uv_faces, texture, tints)
        visible = (seen.boxes, seen.shown, seen.face_id)
        if count and alpha.numel():
            chunks = -(-count // int(k.CHUNK))
            split(k.paint_faces, chunks, count, width, rows, columns, len(tints), *atlas, *visible, colour, grain=4)
        fragments = Fragments(seen.face_id, torch.empty(0), seen.depth)
        pairs = find_silhouette(points, painter.edges, fragments, extent=extent)
        number = len(pairs.first)
        steps = torch.empty((number, 4))
        if number:
            shares, targets = torch.empty(number), torch.empty(number, dtype=torch.int32)
            launch(k.blend_pairs, 1, number, width, points, *pairs, colour, alpha, steps, shares, targets)
        ctx.save_for_backward(*atlas, *visible, *pairs, steps)
        ctx.painter, ctx.uv_gradient = painter, uv_gradient
        return colour.detach(), alpha.detach()

    @staticmethod
    @once_differentiable
    def backward(ctx, grad_colour, grad_alpha):
        k, painter = kernels("paint"), ctx.painter
        saved = ctx.saved_tensors
        atlas, visible, pairs, steps = saved[:6], saved[6:9], saved[9:14], saved[14]
        points, texture, tints, shown = atlas[0], atlas[4], atlas[5], visible[1]
        with_vertices, with_texture, with_tints = ctx.needs_input_grad[:3]
        with_tints = with_tints and len(tints) > 0
        grad = grad_colour.detach().contiguous()
        by_vertex = torch.zeros_like(points)
        width, number = painter.alpha.shape[1], len(steps)
        if number:
            passed = torch.empty((number, 9))
            of_alpha = grad_alpha.detach().contiguous()
            launch(k.blend_adjoint, 1, number, width, points, *pairs, steps, grad, of_alpha, passed, by_vertex)
        by_texture = painter.by_texture if with_texture else torch.empty(0)
        by_tint = torch.zeros_like(tints)
        inner = with_vertices and ctx.uv_gradient
        if len(painter.faces) and texture.numel():
            split(
                k.paint_adjoint, len(painter.band_starts) - 1, width, *painter.texels, len(tints), int(inner),
                int(with_texture), int(with_tints), *atlas, *visible, painter.band_starts, painter.band_faces, grad,
                by_texture, painter.by_face, painter.by_tint, grain=1,
            )  # fmt: skip
            for wanted, of_corners, total in (
                (inner, painter.by_face, by_vertex),
                (with_tints, painter.by_tint, by_tint),
            ):
                if wanted:
                    of_vertices = (painter.corner_starts, painter.corners, shown, of_corners, total)
                    split(k.gather_vertices, len(points), *of_vertices, grain=4096)
        elif with_texture:
            by_texture.zero_()
        if number:
            launch(k.restore_pairs, 1, number, pairs[0], pairs[1], pairs[4], passed, grad)
        asked = (with_vertices, with_texture, ctx.needs_input_grad[2])
        gradients = (by_vertex, by_texture, by_tint)
        return *(own if wanted else None for wanted, own in zip(asked, gradients, strict=True)), None, None, None


def _starts(values: np.ndarray, count: int) -> torch.Tensor:
    """int32 [count + 1], where each value's run begins once `values` are sorted."""
    return torch.from_numpy(np.concatenate([[0], np.cumsum(np.bincount(values, minlength=count))]).astype(np.int32))


def _bands(uvs: torch.Tensor, uv_faces: torch.Tensor, rows: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Which faces read each band of texture rows: starts int32 [B + 1], and 2 * face + (first band of the face)."""
    band, bands = int(kernels("paint").BAND), -(-rows // int(kernels("paint").BAND))
    row = (1 - uvs.numpy()[:, 1].astype(np.float64))[uv_faces.numpy()] * rows - 0.5
    low, high = row.min(axis=1) - _MARGIN, row.max(axis=1) + _MARGIN
    first = (np.clip(np.floor(low), 0, rows - 1) // band).astype(np.int64)
    last = (np.clip(np.floor(high) + 1, 0, rows - 1) // band).astype(np.int64)
    spans = last - first + 1
    face = np.repeat(np.arange(len(row)), spans)
    step = np.arange(len(face)) - np.repeat(np.cumsum(spans) - spans, spans)
    of = first[face] + step
    order = np.argsort(of, kind="stable")
    code = (2 * face + (step == 0))[order].astype(np.int32)
    return _starts(of, bands), torch.from_numpy(code)
