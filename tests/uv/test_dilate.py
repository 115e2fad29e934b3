"""Dilation takes the nearest covered texel, and nothing bleeds at any mip level."""

from __future__ import annotations

import numpy as np
import pytest

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.uv.maintain import refill
from exmesh_graph.uv.raster import dilate
from exmesh_graph.uv.transfer import sample_bilinear
from exmesh_graph.uv.unwrap import unwrap


@pytest.mark.parametrize("radius", [None, 3.0])
def test_nearest_covered_texel(radius):
    rng = np.random.default_rng(1)
    texture, mask = rng.random((20, 17, 3)).astype(np.float32), rng.random((20, 17)) < 0.05
    got = dilate(texture, mask, radius)
    rows, columns = np.nonzero(mask)
    for i in range(20):
        for j in range(17):
            distance = np.hypot(rows - i, columns - j)
            if mask[i, j] or (radius is not None and distance.min() > radius):
                np.testing.assert_array_equal(got[i, j], texture[i, j])
            else:
                nearest = np.flatnonzero(distance == distance.min())
                assert any((got[i, j] == texture[rows[n], columns[n]]).all() for n in nearest)


def test_plain_arrays_and_empty_masks():
    plane = np.arange(9.0).reshape(3, 3)
    mask = np.zeros((3, 3), bool)
    np.testing.assert_array_equal(dilate(plane, mask), plane)
    mask[1, 1] = True
    assert (dilate(plane, mask) == 4).all()


@pytest.mark.thorough
@pytest.mark.parametrize("levels", [0, 1, 2, 3])
def test_red_charts_on_blue_ground_stay_red_at_every_mip_level(levels):
    vertices, faces = icosphere(2)
    size = 256
    uvs, uv_faces = unwrap(vertices, faces, size)
    texture = np.zeros((size, size, 3), np.float32)
    texture[..., 2] = 1.0
    from exmesh_graph.uv.raster import rasterize_atlas

    texture[rasterize_atlas(uvs, uv_faces, size, margin=1.5)[0] >= 0] = [1, 0, 0]
    texture = refill(texture, uvs, uv_faces, radius=16.0)
    for _ in range(levels):
        texture = texture.reshape(texture.shape[0] // 2, 2, texture.shape[1] // 2, 2, 3).mean(axis=(1, 3))
    rng = np.random.default_rng(0)
    corners = uvs[uv_faces].astype(np.float64)
    points = np.einsum("fnk,fkc->fnc", rng.dirichlet([0.3, 0.3, 0.3], (len(faces), 200)), corners).reshape(-1, 2)
    seen = sample_bilinear(texture.astype(np.float64), np.concatenate([points, corners.reshape(-1, 2)]))
    assert seen[:, 2].max() == 0.0
