"""Mip-maps: pyramid, footprint of a pixel, trilinear lookup; against direct computation in float64."""

import math
from itertools import pairwise

import pytest
import torch

from benchmarks.stability.scenes import camera, icosphere
from exmesh_graph.raster import (
    barycentrics,
    interpolate,
    mip_level,
    mip_pyramid,
    project,
    rasterize_projected,
    sample_mipmap,
    sample_texture,
    uv_footprint,
)


def random_texture(height, width, channels=3, dtype=torch.float64):
    return torch.rand(height, width, channels, dtype=dtype, generator=torch.Generator().manual_seed(3))


def test_each_level_is_the_mean_of_two_by_two_texels_and_the_mean_stays():
    pyramid = mip_pyramid(random_texture(16, 8))
    assert [tuple(level.shape[:2]) for level in pyramid] == [(16, 8), (8, 4), (4, 2), (2, 1), (1, 1)]
    for fine, coarse in pairwise(pyramid):
        if fine.shape[1] > 1:
            blocks = fine.view(fine.shape[0] // 2, 2, fine.shape[1] // 2, 2, 3)
            assert torch.allclose(coarse, blocks.mean(dim=(1, 3)))
        assert torch.allclose(coarse.mean(dim=(0, 1)), pyramid[0].mean(dim=(0, 1)))
    assert [tuple(level.shape[:2]) for level in mip_pyramid(random_texture(7, 5), 2)] == [(7, 5), (3, 2)]


def scene(size=24):
    unit, faces = icosphere(1)
    intrinsics, pose = camera(size, size, turn=0.3, shift=(2.0, -1.0))
    projected = project(unit, intrinsics, pose)
    face_id = rasterize_projected(projected, faces, size, size).face_id.view(-1)
    pixels = torch.nonzero(face_id >= 0)[:, 0]
    uvs = torch.rand(len(faces) * 3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    uv_faces = torch.arange(len(faces) * 3).view(-1, 3)
    return projected, faces, uvs, uv_faces, face_id[pixels], pixels, size


def test_the_footprint_is_the_screen_derivative_of_uv():
    projected, faces, uvs, uv_faces, face_id, pixels, size = scene()
    footprint = uv_footprint(projected, faces, uvs, uv_faces, face_id, pixels, size)
    step = 1e-5
    for axis in (0, 1):
        ends = []
        for sign in (1, -1):
            moved = projected.clone()  # moving the pixel by d is moving the picture by -d
            moved[:, axis] -= sign * step * projected[:, 2]
            bary = barycentrics(moved, faces, face_id, pixels, size)
            ends.append(interpolate(uvs, uv_faces, face_id, bary))
        numeric = (ends[0] - ends[1]) / (2 * step)
        assert torch.allclose(footprint[..., axis], numeric, atol=1e-6, rtol=1e-5)


@pytest.mark.thorough
def test_the_footprint_has_gradients():
    projected, faces, uvs, uv_faces, face_id, pixels, size = scene(8)

    def of(p, t):
        return mip_level(uv_footprint(p, faces, t, uv_faces, face_id, pixels, size), 512, 256)

    assert torch.autograd.gradcheck(of, (projected.requires_grad_(), uvs.requires_grad_()))


def test_the_level_counts_texels_under_a_pixel():
    """A pixel of 4 x 2 texels is at level 2, one smaller than a texel at level 0."""
    footprint = torch.diag_embed(torch.tensor([[4 / 64, 2 / 32], [0.1 / 64, 0.1 / 32]], dtype=torch.float64))
    assert mip_level(footprint, 32, 64).tolist() == pytest.approx([2.0, 0.0])
    turned = torch.tensor([[0.0, 8 / 64], [1 / 32, 0.0]], dtype=torch.float64)
    assert float(mip_level(turned, 32, 64)) == pytest.approx(3.0)


@pytest.mark.parametrize(("wrap", "padding"), [("clamp", "border"), ("mirror", "reflection"), ("repeat", "border")])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_trilinear_lookup_against_torch_grid_sample(wrap, padding, dtype):
    """grid_sample at the two levels, mixed by hand; repeating is made by laying copies around the texture."""
    pyramid = mip_pyramid(random_texture(16, 8))
    g = torch.Generator().manual_seed(5)
    uv = torch.rand(200, 2, dtype=torch.float64, generator=g) * 1.8 - 0.4
    level = torch.rand(200, dtype=torch.float64, generator=g) * 6 - 1

    def lookup(texture):
        planes, where = texture.permute(2, 0, 1)[None], uv
        if wrap == "repeat":
            planes, where = planes.repeat(1, 1, 3, 3), (uv + 1) / 3
        grid = torch.stack([2 * where[:, 0] - 1, 1 - 2 * where[:, 1]], dim=-1)[None, None]
        out = torch.nn.functional.grid_sample(planes, grid, padding_mode=padding, align_corners=False)
        return out[0, :, 0].T

    every = torch.stack([lookup(texture) for texture in pyramid])
    held = level.clamp(0, len(pyramid) - 1)
    low = held.floor().long()
    high = (low + 1).clamp(max=len(pyramid) - 1)
    points, mix = torch.arange(200), (held - low)[:, None]
    want = (1 - mix) * every[low, points] + mix * every[high, points]
    got = sample_mipmap([t.to(dtype) for t in pyramid], uv.to(dtype), level.to(dtype), wrap=wrap)
    assert torch.allclose(got.double(), want, atol=2e-5 if dtype == torch.float32 else 1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("wrap", ["clamp", "mirror", "repeat"])
def test_trilinear_gradients_in_float64(wrap):
    g = torch.Generator().manual_seed(2)
    texture = random_texture(6, 5).requires_grad_()
    uv = (torch.rand(9, 2, dtype=torch.float64, generator=g) * 1.7 - 0.3).requires_grad_()
    level = (torch.rand(9, dtype=torch.float64, generator=g) * 2.6 + 0.1).requires_grad_()

    def of(t, q, at):
        return sample_mipmap(mip_pyramid(t), q, at, wrap=wrap)

    assert torch.autograd.gradcheck(of, (texture, uv, level))


def test_a_fine_pattern_seen_from_far_is_grey_and_does_not_flicker():
    """A checkerboard of one texel under pixels of 16 texels: aliased without mip-maps, its mean with them."""
    texels = 256
    board = ((torch.arange(texels)[:, None] + torch.arange(texels)) % 2).float()[..., None]
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=torch.float64)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    uvs = (square[:, :2].float() + 1) / 2
    intrinsics, pose = camera(32, 32, turn=0.2, distance=5.0)
    projected = project(square, intrinsics, pose).float()
    face_id = rasterize_projected(projected, faces, 32, 32).face_id.view(-1)
    pixels = torch.nonzero(face_id >= 0)[:, 0]
    uv = interpolate(uvs, faces, face_id[pixels], barycentrics(projected, faces, face_id[pixels], pixels, 32))
    footprint = uv_footprint(projected, faces, uvs, faces, face_id[pixels], pixels, 32)
    level = mip_level(footprint, texels, texels)
    assert 3.5 < float(level.mean()) < math.log2(64)
    assert float(sample_texture(board, uv).std()) > 0.1
    assert float((sample_mipmap(mip_pyramid(board), uv, level) - 0.5).abs().max()) < 1e-3
