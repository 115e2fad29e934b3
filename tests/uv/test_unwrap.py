"""Atlases are valid for every face, unmirrored, inside the unit square and the same on every run."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.meshes import grid, tetrahedron, torus
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import components, face_areas
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.uv.maintain import check_atlas
from exmesh_graph.uv.raster import rasterize_atlas
from exmesh_graph.uv.settings import DiscSettings
from exmesh_graph.uv.unwrap import unwrap


def rough(vertices, strength, seed=0):
    noise = np.random.default_rng(seed).normal(size=vertices.shape)
    return vertices + (noise * strength).astype(np.float32)


def uv_areas(uvs, uv_faces):
    a, b, c = (uvs[uv_faces[:, k]].astype(np.float64) for k in range(3))
    return 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]))


MESHES = {
    "tetrahedron": tetrahedron(),
    "sphere": icosphere(3),
    "rough": (rough(icosphere(3)[0], 0.06), icosphere(3)[1]),
    "torus": torus(40, 20),
    "neck": torus(30, 3, minor=0.05),
    "sheet": grid(9, 4),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", MESHES)
def test_atlas_is_valid(name):
    vertices, faces = MESHES[name]
    size = 256
    uvs, uv_faces = unwrap(vertices, faces, size, DiscSettings(padding=3))
    assert uvs.dtype == np.float32
    assert uv_faces.dtype == np.int32
    assert uv_faces.shape == faces.shape
    assert 0 <= uvs.min() <= uvs.max() <= 1
    assert (uv_areas(uvs, uv_faces) > 0).all()  # neither mirrored nor folded
    report = check_atlas(vertices, faces, uvs, uv_faces, size)
    assert report.welded == 0
    assert report.flipped == 0
    assert report.overlap < 0.005
    assert report.stretch < 2.0
    assert report.covered > {"rough": 0.2, "neck": 0.08}.get(name, 0.45)
    # charts keep their distance: no texel within the padding of two charts
    charts = components(uv_faces)
    face_id, _ = rasterize_atlas(uvs, uv_faces, size)
    near, _ = rasterize_atlas(uvs, uv_faces, size, margin=0.9)  # 3 - 2 * 0.9 > 1 texel lies between
    owner = np.where(near >= 0, charts[near], -1)
    for axis in (0, 1):
        a, b = owner.take(range(size - 1), axis), owner.take(range(1, size), axis)
        assert ((a == b) | (a < 0) | (b < 0)).all()
    assert (face_id >= 0).sum() > 0


@pytest.mark.thorough
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_and_place_do_not_change_the_atlas(scale):
    vertices, faces = MESHES["sphere"]
    one = unwrap(vertices, faces, 256)
    other = unwrap((vertices.astype(np.float64) * scale).astype(np.float32), faces, 256)
    charts_one, charts_other = components(one[1]).max() + 1, components(other[1]).max() + 1
    assert abs(charts_one - charts_other) <= 2
    np.testing.assert_allclose(uv_areas(*one).sum(), uv_areas(*other).sum(), rtol=0.1)


@pytest.mark.thorough
def test_same_bytes_again():
    vertices, faces = MESHES["rough"]
    first, again = (unwrap(vertices, faces, 512) for _ in range(2))
    assert first[0].tobytes() == again[0].tobytes()
    assert first[1].tobytes() == again[1].tobytes()


def test_texels_have_one_size_everywhere_and_both_ways():
    vertices, faces = MESHES["sphere"]
    uvs, uv_faces = unwrap(vertices, faces, 512)
    p, q = vertices[faces].astype(np.float64), uvs[uv_faces].astype(np.float64)
    ratio = np.linalg.norm(np.roll(q, -1, 1) - q, axis=2) / np.linalg.norm(np.roll(p, -1, 1) - p, axis=2)
    low, middle, high = np.percentile(ratio, [2, 50, 98])
    assert low > 0.7 * middle
    assert high < 1.4 * middle


@pytest.mark.thorough
def test_faces_without_area_get_a_place_beside_their_neighbours():
    vertices, faces = icosphere(2)
    vertices = vertices.copy()
    for f in (3, 40, 41):
        vertices[faces[f, 1]] = vertices[faces[f, 0]]
    flat = face_areas(vertices, faces) == 0
    assert flat.sum() >= 6
    uvs, uv_faces = unwrap(vertices, faces, 256)
    areas = uv_areas(uvs, uv_faces)
    assert (areas[~flat] > 0).all()
    assert np.abs(areas[flat]).max() < 1e-6
    size = np.ptp(uvs[uv_faces], axis=1).max(axis=1)
    assert size[flat].max() <= 2 * size[~flat].max()  # not stretched across the atlas
    pairs = np.unique(np.stack([uv_faces.reshape(-1), faces.reshape(-1)], 1), axis=0)
    assert len(np.unique(pairs[:, 0])) == len(pairs)


@pytest.mark.thorough
def test_nonmanifold_meshes_are_refused_or_cut():
    vertices, faces = icosphere(3)
    rng = np.random.default_rng(0)
    extra = faces[rng.choice(len(faces), 64, replace=False)].copy()
    extra[:, 2] = rng.integers(0, len(vertices), 64)
    extra = extra[(extra[:, 2] != extra[:, 0]) & (extra[:, 2] != extra[:, 1])]
    broken = np.concatenate([faces, extra])
    with pytest.raises(GeometryError, match="edges with more than two faces") as caught:
        unwrap(vertices, broken, 512, DiscSettings(cut_nonmanifold=False))
    assert "cut_nonmanifold" in caught.value.fix
    uvs, uv_faces = unwrap(vertices, broken, 512)
    assert (uv_areas(uvs, uv_faces) > 0).all()
    assert check_atlas(vertices, broken, uvs, uv_faces, 512).welded == 0


def test_unusable_meshes_are_refused():
    vertices, faces = icosphere(1)
    bad = vertices.copy()
    bad[3, 1] = np.nan
    for args, what in (
        ((vertices, faces[:0]), "no faces"),
        ((bad, faces), "not finite"),
        ((np.zeros_like(vertices), faces), "no area"),
        ((vertices, np.concatenate([faces, [[0, 1, 1]]]).astype(np.int32)), "twice"),
    ):
        with pytest.raises(GeometryError, match=what):
            unwrap(*args, 256, DiscSettings(cut_nonmanifold=False))
    with pytest.raises(GeometryError, match="do not fit"):
        unwrap(rough(icosphere(3)[0], 0.3), icosphere(3)[1], 16, DiscSettings(padding=16))
