"""Rows of textures: lookup conventions, wrap modes, mip-maps, what lies between charts."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch

from benchmarks.stability.scenes import camera, icosphere
from benchmarks.stability.table import Reached, elsewhere, row
from exmesh_graph.raster import (
    barycentrics,
    interpolate,
    mip_level,
    mip_pyramid,
    project,
    rasterize_projected,
    sample_mipmap,
    sample_texture,
    shade,
    uv_footprint,
)

BOTH = (torch.float32, torch.float64)

elsewhere("texture", "v flipped, half a texel lost on export to USD", "texel's place", "tests/io/test_usd_write.py")
elsewhere("texture", "USD colour spaces and channels, as Blender renders them", "1/255", "benchmarks/blender.py")
elsewhere(
    "texture", "tangent frames at seams and mirrored charts", "degrees", "normal maps: exported, not rendered yet"
)


@row("texture", "half-texel shift: lookups at texel centres", "largest error", high=1e-5)
def centres() -> Reached:
    reached = []
    for dtype in BOTH:
        texture = torch.rand(37, 53, 2, dtype=dtype, generator=torch.Generator().manual_seed(0))
        i, j = torch.meshgrid(torch.arange(37), torch.arange(53), indexing="ij")
        uv = torch.stack([(j + 0.5).to(dtype) / 53, 1 - (i + 0.5).to(dtype) / 37], dim=-1)
        reached.append(float((sample_texture(texture, uv) - texture).abs().max()))
    return Reached(*reached)


@row("texture", "one bright texel through a PNG file and back", "error of its value at its centre", high=0.5 / 255)
def png_round_trip() -> Reached:
    from exmesh_graph.io.images import read_image, write_image

    picture = np.zeros((16, 24, 3), np.float32)
    picture[3, 17] = 1.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "texel.png"
        write_image(path, picture)
        again = torch.from_numpy(read_image(path).astype(np.float32))
    uv = torch.tensor([[17.5 / 24, 1 - 3.5 / 16]])
    reached = [sample_texture(again.to(t), uv.to(t))[0] for t in BOTH]
    return Reached(*(float((value - 1).abs().max()) for value in reached))


@row("texture", "a texture of one texel: value, and gradient in position", "error or |gradient|", high=1e-6)
def one_texel() -> Reached:
    unit, faces = icosphere(1)
    intrinsics, pose = camera(24, 24)
    reached = []
    for dtype in BOTH:
        projected = project(unit.to(dtype), intrinsics, pose).requires_grad_()
        face_id = rasterize_projected(projected, faces, 24, 24).face_id
        texture = torch.tensor([[[0.2, 0.5, 0.9]]], dtype=dtype)
        uvs = torch.rand(len(unit), 2, dtype=dtype, generator=torch.Generator().manual_seed(0))
        image = shade(projected, faces, uvs, faces, texture, face_id)
        (gradient,) = torch.autograd.grad(image.sum(), projected)
        error = (image[face_id >= 0] - texture[0, 0]).abs().max()
        reached.append(max(float(error.detach()), float(gradient.abs().max())))
    return Reached(*reached)


@row(
    "texture", "red charts on blue ground, trilinear, mip levels 0 to 3", "most blue seen in a chart", high=0, slow=True
)
def bleed() -> Reached:
    from exmesh_graph.geometry.shapes import icosphere as ball
    from exmesh_graph.uv.maintain import refill
    from exmesh_graph.uv.raster import rasterize_atlas
    from exmesh_graph.uv.unwrap import unwrap

    size = 256
    vertices, faces = ball(2)
    uvs, uv_faces = unwrap(vertices, faces, size)
    texture = np.zeros((size, size, 3), np.float32)
    texture[..., 2] = 1.0
    texture[rasterize_atlas(uvs, uv_faces, size, margin=1.5)[0] >= 0] = [1, 0, 0]
    texture = refill(texture, uvs, uv_faces, radius=16.0)
    weights = np.random.default_rng(0).dirichlet([0.3, 0.3, 0.3], (len(faces), 100))
    corners = uvs[uv_faces].astype(np.float64)
    points = np.concatenate([np.einsum("fnk,fkc->fnc", weights, corners).reshape(-1, 2), corners.reshape(-1, 2)])
    reached = []
    for dtype in BOTH:
        pyramid = mip_pyramid(torch.from_numpy(texture).to(dtype))
        uv = torch.from_numpy(points).to(dtype)
        seen = [sample_mipmap(pyramid, uv, uv.new_full((len(uv),), level)) for level in (0, 0.5, 1, 1.7, 2, 2.6, 3)]
        reached.append(float(torch.stack(seen)[..., 2].max()))
    return Reached(*reached)


@row("texture", "minification: squares of 4 texels under pixels of 11", "largest distance from grey", high=1e-3)
def minified() -> Reached:
    """The level comes from the pixels' own footprints; footprints half as large would still show the squares."""
    size = 24
    corners = torch.tensor([[0.0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    reached = []
    for dtype in BOTH:
        projected = 2 * corners.to(dtype) * torch.tensor([size, size, 1], dtype=dtype)
        uvs = torch.stack([corners[:, 0], 1 - corners[:, 1]], dim=1).to(dtype)
        face_id = rasterize_projected(projected, faces, size, size).face_id.view(-1)
        pixels = torch.arange(size * size)
        uv = interpolate(uvs, faces, face_id, barycentrics(projected, faces, face_id, pixels, size))
        footprint = uv_footprint(projected, faces, uvs, faces, face_id, pixels, size)
        board = ((torch.arange(256)[:, None] // 4 + torch.arange(256) // 4) % 2).to(dtype)[..., None]
        grey = sample_mipmap(mip_pyramid(board), uv, mip_level(footprint, 256, 256))
        reached.append(float((grey - 0.5).abs().max()))
    return Reached(*reached)


@row("texture", "repeating 1000 times from the origin, 512 texels", "difference from the first copy", high=0.05)
def far_copies() -> Reached:
    reached = []
    for dtype in BOTH:
        texture = torch.rand(512, 512, 1, dtype=dtype, generator=torch.Generator().manual_seed(0))
        uv = torch.rand(2000, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
        near = sample_texture(texture, uv.to(dtype), wrap="repeat")
        far = sample_texture(texture, (uv + torch.tensor([1000.0, -1000.0])).to(dtype), wrap="repeat")
        reached.append(float((near - far).abs().max()))
    return Reached(*reached)


@row("texture", "uv that are not numbers, infinite or enormous", "lookups or gradients outside the texture", high=0)
def broken_uv() -> Reached:
    """The texture is the number 1, and its neighbours in memory are not: any texel outside would show."""
    wrong = 0
    for wrap in ("clamp", "repeat", "mirror"):
        texture = torch.ones(8, 8, 1, requires_grad=True)
        uv = torch.tensor([[1e30, -1e30], [3e9, 0.5], [-1e20, 1e20], [torch.nan, torch.inf]])
        value = sample_texture(texture, uv, wrap=wrap)[:3]
        (gradient,) = torch.autograd.grad(value.sum(), texture)
        wrong += int((value.detach() - 1).abs().max() > 1e-3) + int(abs(float(gradient.sum()) - 3) > 1e-2)
    return Reached(float(wrong))


@row("texture", "sparse texel gradients, 5000 lookups in 256^2 texels", "difference from the dense ones", high=1e-5)
def sparse() -> Reached:
    texture = torch.rand(256, 256, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    uv = torch.rand(5000, 2, generator=torch.Generator().manual_seed(1)) * 0.4
    dense, thin = (
        torch.autograd.grad(sample_texture(texture, uv, sparse=s).square().sum(), texture)[0] for s in (False, True)
    )
    exact = texture.detach().double().requires_grad_()
    (want,) = torch.autograd.grad(sample_texture(exact, uv.double()).square().sum(), exact)
    return Reached(float((dense - thin.to_dense()).abs().max()), float((thin.to_dense() - want).abs().max()) / 10)
