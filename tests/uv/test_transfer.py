"""Textures survive a change of atlas: by value, without shift, without bleeding; moments too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types import Stage1State
from exmesh_graph.uv.raster import rasterize_atlas
from exmesh_graph.uv.settings import DiscSettings
from exmesh_graph.uv.transfer import sample_bilinear, transfer_texture
from exmesh_graph.uv.unwrap import regenerate, unwrap

SIZE = 256


@lru_cache
def atlases():
    """A mesh and two different atlases of it."""
    vertices, faces = icosphere(3)
    return (
        vertices,
        faces,
        unwrap(vertices, faces, SIZE),
        unwrap(vertices, faces, SIZE, DiscSettings(bend=0.1, padding=3)),
    )


def paint(function, uvs, uv_faces, size=SIZE):
    """A texture of a function of the surface point, on all texels that lookups can read."""
    vertices, faces, *_ = atlases()
    face_id, bary = rasterize_atlas(uvs, uv_faces, size, margin=1.5)
    hit = face_id >= 0
    texture = np.full((size, size, 1), 0.5, np.float32)
    texture[hit, 0] = function(np.einsum("nk,nkc->nc", bary[hit], vertices[faces[face_id[hit]]]))
    return texture, rasterize_atlas(uvs, uv_faces, size)[0] >= 0


def checker(period):
    """Cells of half a period, with edges about two texels wide: what a texture can hold."""
    vertices, faces, (uvs, uv_faces), _ = atlases()
    corners = uvs[uv_faces].astype(np.float64)
    d, e = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uv_area = 0.5 * (d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]).sum()
    texel = np.sqrt(face_areas(vertices, faces).sum() / (uv_area * SIZE * SIZE))
    w = 2 * np.pi / (period * texel)
    return lambda p: 0.5 + 0.5 * np.prod(np.clip(np.sin(p * w) * period * 0.16, -1, 1), axis=1)


def psnr(a, b):
    return -10 * np.log10(np.mean((a - b) ** 2))


def at_surface(texture, uvs, uv_faces, n=50_000):
    _, faces, *_ = atlases()
    rng = np.random.default_rng(3)
    face, bary = rng.integers(0, len(faces), n), rng.dirichlet([1, 1, 1], n)
    return sample_bilinear(texture, np.einsum("nk,nkc->nc", bary, uvs[uv_faces[face]].astype(np.float64)))


@pytest.mark.thorough
def test_checkerboard_round_trip():
    _, _, one, two = atlases()
    texture, inside = paint(checker(32), *one)
    moved, _ = transfer_texture({"t": texture}, *one, *two, SIZE, bounds=(0, 1))
    back, _ = transfer_texture(moved, *two, *one, SIZE, bounds=(0, 1))
    assert psnr(back["t"][inside], texture[inside]) > 35
    assert psnr(at_surface(moved["t"], *two), at_surface(texture, *one)) > 35
    plain, _ = transfer_texture({"t": texture}, *one, *two, SIZE, sharpen=0)
    plain, _ = transfer_texture(plain, *two, *one, SIZE, sharpen=0)
    assert psnr(plain["t"][inside], texture[inside]) < psnr(back["t"][inside], texture[inside]) - 3


def test_no_shift():
    # the position itself as a texture: any shift by a part of a texel shows as a mean offset
    _, _, one, two = atlases()
    for axis in range(3):
        texture, _ = paint(lambda p, k=axis: p[:, k], *one)
        moved, covered = transfer_texture({"t": texture}, *one, *two, SIZE)
        want, inside = paint(lambda p, k=axis: p[:, k], *two)
        error = (moved["t"] - want)[inside]
        texel = np.sqrt(4 * np.pi / inside.sum())
        assert abs(error.mean()) < 0.005 * texel
        assert np.abs(error).max() < 0.35 * texel
        assert covered[inside].all()


def test_the_same_atlas_gives_the_same_texture():
    _, _, one, _ = atlases()
    texture = np.random.default_rng(0).random((SIZE, SIZE, 3)).astype(np.float32)
    moved, _ = transfer_texture({"t": texture}, *one, *one, SIZE)
    inside = rasterize_atlas(*one, SIZE)[0] >= 0
    np.testing.assert_allclose(moved["t"][inside], texture[inside], atol=2e-3)


def test_ground_between_charts_never_bleeds_in():
    _, _, one, two = atlases()
    texture, _ = paint(lambda p: np.full(len(p), 0.25), *one)
    outside = rasterize_atlas(*one, SIZE, margin=1.5)[0] < 0
    texture[outside] = 100.0
    moved, _ = transfer_texture({"t": texture}, *one, *two, SIZE)
    np.testing.assert_allclose(moved["t"], 0.25, atol=1e-6)  # everywhere: filled to the last texel


@pytest.mark.thorough
def test_resolution_may_change():
    vertices, faces, one, _ = atlases()
    fine = unwrap(vertices, faces, 2 * SIZE)
    texture, _ = paint(checker(32), *one)
    moved, covered = transfer_texture({"t": texture}, *one, *fine, 2 * SIZE, bounds=(0, 1))
    assert moved["t"].shape == (2 * SIZE, 2 * SIZE, 1)
    assert covered.shape == (2 * SIZE, 2 * SIZE)
    assert psnr(at_surface(moved["t"], *fine), at_surface(texture, *one)) > 35


def test_bilinear_lookup_convention():
    texture = np.arange(12.0).reshape(3, 4, 1)
    u, v = np.meshgrid((np.arange(4) + 0.5) / 4, 1 - (np.arange(3) + 0.5) / 3)
    np.testing.assert_allclose(sample_bilinear(texture, np.stack([u, v], -1).reshape(-1, 2))[:, 0], np.arange(12))
    got = sample_bilinear(texture, np.array([[0.0, 1.0], [1.0, 0.0], [0.25, 1 - 1 / 6]]))
    np.testing.assert_allclose(got[:, 0], [0, 11, 0.5])


@pytest.mark.slow
def test_moments_move_with_their_texels():
    vertices, faces, one, _ = atlases()
    m, _ = paint(lambda p: p[:, 0], *one)
    v, _ = paint(lambda p: p[:, 0] ** 2, *one)
    m, v = (np.repeat(moment, 3, axis=2).astype(np.float32) for moment in (m, v))
    still = np.zeros((len(vertices), 3), np.float32)
    state = Stage1State(
        vertices, faces, *one, np.clip(m, 0, 1), vertex_m=still, vertex_v=still[:, 0], texture_m=m, texture_v=v,
        gradient_ema=still[:, 0],
    )  # fmt: skip
    for size in (SIZE, 2 * SIZE):
        new = regenerate(state, size, DiscSettings(bend=0.1))
        assert new.texture_v.min() >= 0
        assert new.texture.shape == new.texture_m.shape == (size, size, 3)
        x, covered = paint(lambda p: p[:, 0], new.uvs, new.uv_faces, size)
        strong = (np.abs(x[..., 0]) > 0.2) & covered
        ratio = (new.texture_m[..., 0] / np.where(x[..., 0] == 0, 1, x[..., 0]))[strong]
        growth = np.median(ratio)
        np.testing.assert_allclose(ratio, growth, rtol=0.1)
        assert 0.75 < growth * (size / SIZE) ** 2 < 1.5  # a texel of half the side gathers a quarter of the gradient
        # Adam's step m / sqrt(v) is what it was
        step = new.texture_m[strong] / np.sqrt(new.texture_v[strong])
        np.testing.assert_allclose(np.abs(step), 1.0, atol=0.05)


def test_atlases_of_different_meshes_are_refused():
    _, _, (uvs, uv_faces), _ = atlases()
    with pytest.raises(GeometryError, match="same faces"):
        transfer_texture({"t": np.zeros((8, 8, 1))}, uvs, uv_faces, uvs, uv_faces[:-1], 8)
