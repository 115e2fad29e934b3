"""Texel ownership against point-in-triangle tests, edge rules, margins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.uv.raster import coverage_counts, rasterize_atlas
from exmesh_graph.uv.unwrap import unwrap


def centres(height, width):
    i, j = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    return np.stack([(j + 0.5) / width, 1 - (i + 0.5) / height], axis=-1)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 24), st.integers(1, 24), st.booleans())
def test_one_triangle_equals_the_point_test(seed, height, width, wide):
    rng = np.random.default_rng(seed)
    uvs = rng.uniform(-0.5, 1.5, (3, 2)) if wide else rng.random((3, 2))
    face_id, bary = rasterize_atlas(uvs, np.array([[0, 1, 2]]), (height, width))
    a, b, c = uvs
    m = np.stack([b - a, c - a], axis=1)
    weights = np.linalg.solve(m, (centres(height, width) - a)[..., None])[..., 0]
    want = np.concatenate([1 - weights.sum(-1, keepdims=True), weights], axis=-1)
    clear = np.abs(want).min(axis=-1) > 1e-9
    inside = (want > 0).all(axis=-1)
    np.testing.assert_array_equal((face_id >= 0)[clear], inside[clear])
    np.testing.assert_allclose(bary[inside & clear], want[inside & clear], atol=1e-6)
    assert (bary[face_id < 0] == 0).all()


def test_every_centre_of_a_tiled_square_has_exactly_one_face():
    # corners and diagonals fall exactly on texel centres
    n = 8
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    uvs = (np.stack([j, i], axis=-1).reshape(-1, 2) * 4 + 0.5) / 33.0
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    face_id, bary = rasterize_atlas(uvs, faces, 33)
    # half-open: 32 rows and columns of centres belong to the square, each to exactly one face
    assert (face_id >= 0).sum() == 32 * 32
    hits = sum((rasterize_atlas(uvs, faces[f : f + 1], 33)[0] >= 0).astype(int) for f in range(len(faces)))
    assert hits.max() == 1
    np.testing.assert_array_equal(coverage_counts(uvs, faces, 33), hits)
    doubled = np.concatenate([faces, faces[:5]])
    assert (coverage_counts(uvs, doubled, 33) == 2).sum() == np.isin(face_id, range(5)).sum()
    np.testing.assert_allclose(bary[face_id >= 0].sum(-1), 1, atol=1e-6)


@pytest.mark.thorough
def test_bary_leads_back_to_the_texel_centre():
    vertices, faces = icosphere(3)
    uvs, uv_faces = unwrap(vertices, faces, 200)
    face_id, bary = rasterize_atlas(uvs, uv_faces, 200)
    hit = face_id >= 0
    uv = np.einsum("nk,nkc->nc", bary[hit], uvs[uv_faces[face_id[hit]]])
    np.testing.assert_allclose(uv, centres(200, 200)[hit], atol=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("margin", [0.75, 1.5, 6.0])
def test_margin_gives_the_nearest_point_of_the_charts(margin):
    from scipy.ndimage import distance_transform_edt

    vertices, faces = icosphere(1)
    uvs, uv_faces = unwrap(vertices, faces, 64)
    size = 64
    inside, bary_inside = rasterize_atlas(uvs, uv_faces, size)
    face_id, bary = rasterize_atlas(uvs, uv_faces, size, margin=margin)
    np.testing.assert_array_equal(face_id[inside >= 0], inside[inside >= 0])
    np.testing.assert_array_equal(bary[inside >= 0], bary_inside[inside >= 0])
    border = (face_id >= 0) & (inside < 0)
    uv = np.einsum("nk,nkc->nc", bary[border], uvs[uv_faces[face_id[border]]])
    distance = np.linalg.norm(uv - centres(size, size)[border], axis=1) * size
    assert bary[border].min() >= 0
    assert distance.max() <= margin + 1e-4
    # against a dense point cloud on the charts
    rng = np.random.default_rng(0)
    cloud = np.einsum(
        "fnk,fkc->fnc", rng.dirichlet([0.5, 0.5, 0.5], (len(faces), 3000)), uvs[uv_faces].astype(np.float64)
    )
    fine = 1024
    grid = np.zeros((fine, fine), bool)
    pixel = (cloud.reshape(-1, 2) * fine).astype(int)
    grid[fine - 1 - pixel[:, 1], pixel[:, 0]] = True
    away = (
        distance_transform_edt(~grid)[fine // size // 2 :: fine // size, fine // size // 2 :: fine // size]
        * size
        / fine
    )
    np.testing.assert_allclose(distance, away[border], atol=0.35)
    assert (away[face_id < 0] > margin - 0.35).all()


def test_margin_of_0_75_covers_every_touched_texel():
    uvs = np.array([[0.501, 0.501], [0.51, 0.501], [0.51, 0.508]])  # smaller than a texel of 1/16, off its centre
    faces = np.array([[0, 1, 2]])
    assert (rasterize_atlas(uvs, faces, 16)[0] < 0).all()
    assert rasterize_atlas(uvs, faces, 16, margin=0.75)[0][7, 8] == 0


def test_same_bytes_again():
    vertices, faces = icosphere(3)
    uvs, uv_faces = unwrap(vertices, faces, 128)
    first, again = (rasterize_atlas(uvs, uv_faces, 128, margin=2.0) for _ in range(2))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))
