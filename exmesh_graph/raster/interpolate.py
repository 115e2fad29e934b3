"""Perspective-correct interpolation over the visible faces, and the textured image of a mesh.

`barycentrics` and `interpolate` are plain torch in any float type; `shade` is the fused form for the hot loop of
Stage I (uv and texture in one Warp kernel, analytic adjoint) and is checked against them.
"""

from __future__ import annotations

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.gpu.limits import check_indices, check_size
from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.raster.runtime import each_view, kernels
from exmesh_graph.raster.texture import sample_adjoint, sample_texture


def barycentrics(
    projected: torch.Tensor,
    faces: torch.Tensor,
    face_id: torch.Tensor,
    pixels: torch.Tensor,
    width: int,
    height: int | None = None,
) -> torch.Tensor:
    """Barycentric coordinates [P, 3] of the given pixel centres in the given faces; differentiable.

    projected  [V, 3] homogeneous pixel coordinates (`camera.project`), or [N, V, 3] with `height` given
    face_id    [P] the face at each pixel;  pixels  [P] flat indices (view * height + row) * width + column
    """
    row_x, row_y, _ = _corner_rows(projected, faces, face_id, pixels, width, height)
    # u = x' x y' with a' = a - z_a (x, y): see kernels.py
    u = torch.linalg.cross(row_x, row_y)
    return u / u.sum(-1, keepdim=True)


def uv_footprint(
    projected: torch.Tensor,
    faces: torch.Tensor,
    uvs: torch.Tensor,
    uv_faces: torch.Tensor,
    face_id: torch.Tensor,
    pixels: torch.Tensor,
    width: int,
    height: int | None = None,
) -> torch.Tensor:
    """The exact screen derivative of uv, [P, 2, 2]: d(u, v)[i] / d(x, y)[j] per pixel; differentiable.

    Arguments as `barycentrics`, with `uvs` [T, 2] indexed per corner by `uv_faces` [F, 3]. With u = X x Y over the
    corners' rows X = x - p_x z and Y = y - p_y z:  du/dp_x = Y x z,  du/dp_y = z x X,  db = (du - b sum(du)) / sum(u).
    """
    row_x, row_y, z = _corner_rows(projected, faces, face_id, pixels, width, height)
    u = torch.linalg.cross(row_x, row_y)
    slope = torch.stack([torch.linalg.cross(row_y, z), torch.linalg.cross(z, row_x)], dim=-1)
    total = u.sum(-1)[:, None, None]
    slope = (slope - u[..., None] / total * slope.sum(1, keepdim=True)) / total
    corners = uvs.to(projected.dtype)[uv_faces.long()[face_id.long()]]
    return corners.mT @ slope


def _corner_rows(
    projected: torch.Tensor,
    faces: torch.Tensor,
    face_id: torch.Tensor,
    pixels: torch.Tensor,
    width: int,
    height: int | None,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(x - p_x z, y - p_y z, z) of the corners of the face at each pixel, each [P, 3]."""
    vertex = faces.long()[face_id.long()]
    row = pixels // width
    if projected.dim() == 3:
        if height is None:
            raise ValueError("a batch of views needs the image's height beside its width")
        vertex = vertex + (row // height * projected.shape[1])[:, None]
        row = row % height
    corners = projected.reshape(-1, 3)[vertex]
    x = (pixels % width).to(projected.dtype)[:, None] + 0.5
    y = row.to(projected.dtype)[:, None] + 0.5
    return corners[..., 0] - x * corners[..., 2], corners[..., 1] - y * corners[..., 2], corners[..., 2]


def interpolate(
    attributes: torch.Tensor, attribute_faces: torch.Tensor, face_id: torch.Tensor, bary: torch.Tensor
) -> torch.Tensor:
    """sum_i b_i a_i over the corners: [..., C] for `face_id` [...] and `bary` [..., 3]; 0 where face_id is -1.

    `attributes` [A, C] are indexed per corner by `attribute_faces` [F, 3] (the mesh's faces, or its uv_faces).
    Differentiable in `attributes` and `bary`.
    """
    seen = face_id >= 0
    out = attributes.new_zeros((*face_id.shape, attributes.shape[-1]))
    corners = attributes[attribute_faces.long()[face_id[seen].long()]]
    return out.masked_scatter(seen[..., None], (bary[seen][..., None] * corners).sum(-2))


def shade(
    projected: torch.Tensor,
    faces: torch.Tensor,
    uvs: torch.Tensor,
    uv_faces: torch.Tensor,
    texture: torch.Tensor,
    face_id: torch.Tensor,
    *,
    sparse: bool = False,
) -> torch.Tensor:
    """The texture's value [H, W, C] at every pixel (0 on the background); differentiable.

    projected   [V, 3] for face_id [H, W]; [N, V, 3] for [N, H, W]

    Gradients go to `texture` [R, S, C] and, through the uv under each pixel, to `projected`; a `projected` that
    requires none makes the image a function of the texture alone. Indices int32 (others are converted). `sparse`
    makes the texture's gradient a sparse tensor (see `sample_texture`).
    """
    if projected.dtype != torch.float32 or texture.dtype != torch.float32:
        if sparse:
            raise ValueError("sparse texel gradients need float32")
        return shade_reference(projected, faces, uvs, uv_faces, texture, face_id)
    check_size(colours=face_id.shape[-2] * face_id.shape[-1] * texture.shape[-1], texels=texture.numel())
    device = projected.device
    faces, uv_faces = (f.to(device, torch.int32).contiguous() for f in (faces, uv_faces))
    check_indices("faces", faces, projected.shape[-2])
    check_indices("uv_faces", uv_faces, len(uvs))
    uvs = uvs.to(device, torch.float32).contiguous()
    return _Shade.apply(projected, texture, faces, uvs, uv_faces, face_id, sparse)


def shade_reference(
    projected: torch.Tensor,
    faces: torch.Tensor,
    uvs: torch.Tensor,
    uv_faces: torch.Tensor,
    texture: torch.Tensor,
    face_id: torch.Tensor,
) -> torch.Tensor:
    """`shade` in plain torch, for any float type."""
    height, width = face_id.shape[-2:]
    flat = face_id.reshape(-1)
    pixels = torch.nonzero(flat >= 0)[:, 0]
    bary = barycentrics(projected, faces, flat[pixels], pixels, width, height)
    uv = interpolate(uvs.to(projected.dtype), uv_faces, flat[pixels], bary)
    colour = sample_texture(texture, uv)
    out = colour.new_zeros((len(flat), texture.shape[-1]))
    return out.index_copy(0, pixels, colour).view(*face_id.shape, -1)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx, projected, texture, faces, uvs, uv_faces, face_id, sparse):
        projected, texture, face_id = projected.contiguous(), texture.contiguous(), face_id.contiguous()
        height, width = face_id.shape[-2:]
        uv = torch.full((*face_id.shape, 2), -1.0, dtype=torch.float32, device=projected.device)
        out = torch.zeros((*face_id.shape, texture.shape[-1]), dtype=torch.float32, device=projected.device)
        if len(faces) and out.numel() and texture.numel():
            atlas = (faces, uvs, uv_faces, texture)
            for points, ids, *results in each_view(projected, face_id, uv, out):
                launch(kernels("texture").shade, height * width, points, *atlas, ids, width, *texture.shape, *results)
        ctx.save_for_backward(projected, texture, faces, uvs, uv_faces, face_id, uv)
        ctx.sparse = sparse
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        projected, texture, faces, uvs, uv_faces, face_id, uv = ctx.saved_tensors
        with_vertices, with_texture = ctx.needs_input_grad[:2]
        seen = face_id >= 0
        # background pixels carry no texture value: drop what the loss says of them
        grad = torch.where(seen[..., None], grad, 0.0).contiguous()
        grad_texture, grad_uv = sample_adjoint(
            texture, uv, grad, "clamp", with_texture, with_vertices, sparse=ctx.sparse, seen=seen
        )
        grad_vertices = None
        if grad_uv is not None:
            grad_vertices = torch.zeros_like(projected)
            height, width = face_id.shape[-2:]
            if len(faces) and grad.numel():
                adjoint, atlas = kernels("texture").shade_vertices_adjoint, (faces, uvs, uv_faces)
                for points, *pixels, by_vertex in each_view(projected, face_id, grad_uv, grad_vertices):
                    launch(adjoint, height * width, points, *atlas, *pixels, width, by_vertex)
        return grad_vertices, grad_texture, None, None, None, None, None
