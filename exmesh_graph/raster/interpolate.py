"""Perspective-correct interpolation over the visible faces, and the textured image of a mesh.

`barycentrics` and `interpolate` are plain torch in any float type; `shade` is the fused form for the hot loop of
Stage I (uv and texture in one Warp kernel, analytic adjoint) and is checked against them.
"""

from __future__ import annotations

import torch
from torch.autograd.function import once_differentiable

from exmesh_graph.raster.texture import sample_texture
from exmesh_graph.raster.warp_runtime import kernels, launch


def barycentrics(
    projected: torch.Tensor, faces: torch.Tensor, face_id: torch.Tensor, pixels: torch.Tensor, width: int
) -> torch.Tensor:
    """Barycentric coordinates [P, 3] of the given pixel centres in the given faces; differentiable.

    projected  [V, 3] homogeneous pixel coordinates (`camera.project`)
    face_id    [P] the face at each pixel;  pixels  [P] flat indices row * width + column
    """
    corners = projected[faces.long()[face_id.long()]]
    x = (pixels % width).to(projected.dtype)[:, None] + 0.5
    y = (pixels // width).to(projected.dtype)[:, None] + 0.5
    # u = x' x y' with a' = a - z_a (x, y): see kernels.py
    u = torch.linalg.cross(corners[..., 0] - x * corners[..., 2], corners[..., 1] - y * corners[..., 2])
    return u / u.sum(-1, keepdim=True)


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
) -> torch.Tensor:
    """The texture's value [H, W, C] at every pixel (0 on the background); differentiable.

    Gradients go to `texture` [R, S, C] and, through the uv under each pixel, to `projected` [V, 3]; a `projected`
    that requires none makes the image a function of the texture alone. Indices int32 (others are converted).
    """
    if projected.dtype != torch.float32 or texture.dtype != torch.float32:
        return shade_reference(projected, faces, uvs, uv_faces, texture, face_id)
    device = projected.device
    return _Shade.apply(
        projected,
        texture,
        faces.to(device, torch.int32).contiguous(),
        uvs.to(device, torch.float32).contiguous(),
        uv_faces.to(device, torch.int32).contiguous(),
        face_id,
    )


def shade_reference(
    projected: torch.Tensor,
    faces: torch.Tensor,
    uvs: torch.Tensor,
    uv_faces: torch.Tensor,
    texture: torch.Tensor,
    face_id: torch.Tensor,
) -> torch.Tensor:
    """`shade` in plain torch, for any float type."""
    height, width = face_id.shape
    flat = face_id.reshape(-1)
    pixels = torch.nonzero(flat >= 0)[:, 0]
    bary = barycentrics(projected, faces, flat[pixels], pixels, width)
    uv = interpolate(uvs.to(projected.dtype), uv_faces, flat[pixels], bary)
    colour = sample_texture(texture, uv)
    out = colour.new_zeros((height * width, texture.shape[-1]))
    return out.index_copy(0, pixels, colour).view(height, width, -1)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx, projected, texture, faces, uvs, uv_faces, face_id):
        projected, texture, face_id = projected.contiguous(), texture.contiguous(), face_id.contiguous()
        height, width = face_id.shape
        rows, columns, channels = texture.shape
        uv = torch.full((height * width, 2), -1.0, dtype=torch.float32, device=projected.device)
        out = torch.zeros((height, width, channels), dtype=torch.float32, device=projected.device)
        if len(faces) and out.numel() and texture.numel():
            launch(
                kernels().shade,
                height * width,
                projected,
                faces,
                uvs,
                uv_faces,
                texture.view(-1),
                face_id.view(-1),
                width,
                rows,
                columns,
                channels,
                uv,
                out.view(-1),
            )
        ctx.save_for_backward(projected, texture, faces, uvs, uv_faces, face_id, uv)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        projected, texture, faces, uvs, uv_faces, face_id, uv = ctx.saved_tensors
        rows, columns, channels = texture.shape
        with_vertices, with_texture = ctx.needs_input_grad[:2]
        grad_vertices = torch.zeros_like(projected) if with_vertices else None
        grad_texture = torch.zeros_like(texture) if with_texture else None
        seen = len(faces) and grad.numel() and texture.numel()
        if not seen or not (with_vertices or with_texture):
            return grad_vertices, grad_texture, None, None, None, None
        k = kernels()
        # background pixels carry no texture value: drop what the loss says of them
        grad = torch.where((face_id >= 0)[..., None], grad, 0.0).contiguous()
        grad_uv = torch.zeros_like(uv)
        launch(
            k.sample_bilinear_adjoint,
            len(uv),
            texture.view(-1),
            uv,
            grad.view(-1),
            rows,
            columns,
            channels,
            int(with_vertices),
            int(with_texture),
            grad_texture.view(-1) if grad_texture is not None else texture.new_zeros(1),
            grad_uv,
        )
        if with_vertices:
            launch(
                k.shade_vertices_adjoint,
                len(uv),
                projected,
                faces,
                uvs,
                uv_faces,
                face_id.view(-1),
                grad_uv,
                face_id.shape[1],
                grad_vertices,
            )
        return grad_vertices, grad_texture, None, None, None, None
