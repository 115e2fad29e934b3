"""Whatever triangles come: an atlas in which nothing is mirrored, welded or over something else, in bounded time."""

from __future__ import annotations

import sys
import time
from itertools import combinations

import numpy as np
import pytest
from exmesh_nodes import uv

from exmesh_graph.geometry.adjacency import components, face_areas
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Mesh
from exmesh_graph.uv import xatlas_charts as guarded
from exmesh_graph.uv.maintain import check_atlas
from exmesh_graph.uv.settings import DiscSettings, XatlasSettings
from exmesh_graph.uv.unwrap import unwrap

SIZE = 512


def rough_sphere(level=3):
    vertices, faces = icosphere(level)
    noise = np.random.default_rng(1).normal(size=vertices.shape) * 0.15 * np.sqrt(30.0 / len(faces))
    return (vertices + noise).astype(np.float32), faces


def broken(kind, level=3):
    """A rough sphere with 5 % of its faces in trouble."""
    vertices, faces = rough_sphere(level)
    rng = np.random.default_rng(0)
    n = len(faces) // 20
    some = faces[rng.choice(len(faces), n, replace=False)]
    if kind == "duplicates":
        return vertices, np.concatenate([faces, np.roll(some, 1, axis=1)])
    if kind == "backs":
        return vertices, np.concatenate([faces, some[:, ::-1]])
    if kind == "triple edges":
        tips = vertices[some].mean(axis=1) * rng.uniform(1.05, 1.2, (n, 1))
        fins = np.stack([some[:, 0], some[:, 1], len(vertices) + np.arange(n)], axis=1)
        return np.concatenate([vertices, tips]).astype(np.float32), np.concatenate([faces, fins])
    if kind == "degenerate":
        vertices[some[:, 0]] = vertices[some[:, 1]]
        return vertices, faces
    if kind == "collapsed":
        return vertices, np.concatenate([faces, some[:, [0, 0, 1]]])
    if kind == "isolated":
        loose = rng.normal(size=(3 * n, 3))
        return (
            np.concatenate([vertices, loose * 0.1]).astype(np.float32),
            np.concatenate([faces, len(vertices) + np.arange(3 * n).reshape(-1, 3)]),
        )
    if kind == "holes":
        return vertices, faces[rng.random(len(faces)) < 0.9]
    if kind == "soup":
        return rng.normal(size=(60, 3)).astype(np.float32), np.array(list(combinations(range(60), 3)))[
            rng.choice(34220, 300, replace=False)
        ]
    assert kind == "crumpled"
    return rng.normal(size=(162, 3)).astype(np.float32), icosphere(2)[1]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "kind",
    ["duplicates", "backs", "triple edges", "degenerate", "collapsed", "isolated", "holes", "soup", "crumpled"],
)
def test_broken_meshes_get_a_sound_atlas(kind):
    vertices, faces = broken(kind)
    uvs, uv_faces = unwrap(vertices, faces.astype(np.int32), SIZE, DiscSettings(padding=2))
    report = check_atlas(vertices, faces, uvs, uv_faces, SIZE)
    assert report.welded == report.flipped == 0
    # a face that repeats another one shows the same texels; all else has its own
    assert report.overlap < (0.08 if kind == "duplicates" else 1e-3)
    assert report.covered > 0.1
    if kind in ("duplicates", "degenerate", "collapsed"):
        real = face_areas(vertices, faces) > 1e-9
        assert components(uv_faces[real]).max() < 60  # the surface itself is not cut at every such face


def test_a_repeated_face_shows_the_texels_of_the_first():
    vertices, faces = icosphere(1)
    again = np.concatenate([faces, faces[[5, 9]][:, [2, 0, 1]]]).astype(np.int32)
    _, uv_faces = unwrap(vertices, again, 128)
    np.testing.assert_array_equal(uv_faces[-2:], uv_faces[[5, 9]][:, [2, 0, 1]])
    assert components(uv_faces).max() <= 12


def test_at_an_edge_with_three_faces_the_smoothest_two_stay_together():
    # two coplanar triangles and a fin upright on their common edge
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 1]], np.float32)
    faces = np.array([[4, 1, 2], [0, 1, 2], [3, 2, 1]], np.int32)
    _, uv_faces = unwrap(vertices, faces, 64, DiscSettings(padding=1))
    chart = components(uv_faces)
    assert chart[1] == chart[2] != chart[0]


def test_nodes_cut_and_say_so():
    vertices, faces = broken("triple edges")
    context = FakeContext()
    carrier = uv.unwrap(context, Mesh(vertices, faces.astype(np.int32)), p=uv.UnwrapParams(texture_size=256)).carrier
    assert "more than two faces" in context.warnings[0]
    assert check_atlas(vertices, faces, carrier.uvs, carrier.uv_faces, 256).flipped == 0


@pytest.mark.thorough
def test_xatlas_is_ended_when_its_time_is_up():
    vertices, faces = rough_sphere()
    context, begun = FakeContext(), time.monotonic()
    params = uv.XatlasUnwrapParams(texture_size=256, max_seconds=0.05)
    got = uv.xatlas_unwrap(context, Mesh(vertices, faces), p=params).carrier
    assert time.monotonic() - begun < 30
    assert "not done after 0.05 s" in context.warnings[0]
    own, own_faces = unwrap(vertices, faces, 256)
    assert got.uvs.tobytes() == own.tobytes()
    assert got.uv_faces.tobytes() == own_faces.tobytes()


def test_a_death_of_xatlas_is_told(monkeypatch):
    monkeypatch.setattr(guarded, "_CHILD", "import os; os.abort()")
    told: list[str] = []
    uvs, _ = unwrap(*icosphere(1), 64, XatlasSettings(), warn=told.append)
    assert "ended with status -6" in told[0]
    assert len(uvs)


@pytest.mark.thorough
def test_xatlas_charts():
    vertices, faces = rough_sphere()
    before = "xatlas" in sys.modules
    first, again = (unwrap(vertices, faces, 256, XatlasSettings(), warn=pytest.fail) for _ in range(2))
    assert first[0].tobytes() == again[0].tobytes()
    report = check_atlas(vertices, faces, *first, 256)
    assert report.welded == report.flipped == 0
    assert report.overlap < 0.005
    assert ("xatlas" in sys.modules) == before  # it stays in its own process


@pytest.mark.thorough
def test_few_charts_on_a_rough_surface():
    vertices, faces = rough_sphere(4)
    first = unwrap(vertices, faces, 512)
    report = check_atlas(vertices, faces, *first, 512)
    assert report.charts <= 12
    assert report.stretch < 1.2


@pytest.mark.thorough
def test_same_bytes_on_a_rough_surface():
    vertices, faces = rough_sphere()
    first, again = (unwrap(vertices, faces, 512) for _ in range(2))
    assert first[0].tobytes() == again[0].tobytes()
    assert first[1].tobytes() == again[1].tobytes()
