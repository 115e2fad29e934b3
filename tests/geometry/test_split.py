"""Vertex splitting against its sequential definition, and what it must never break."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from topology_meshes import SHAPES, canonical, check_topology, meshes, same_sharing, unwrapped
from topology_reference import curvature, split_round

from benchmarks.meshes import grid
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas, signed_volume
from exmesh_graph.geometry.settings import SplitSettings
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.split import apply_splits, face_curvature, plan_splits, split
from exmesh_graph.geometry.topology import Topology, VertexMap
from exmesh_graph.types.edges import is_closed

slow_but_few = settings(max_examples=30, deadline=None)


@pytest.mark.thorough
@slow_but_few
@given(
    meshes(), st.sampled_from(["opposite", "endpoints"]), st.sampled_from(["ranks", "values"]),
    st.sampled_from([0.0, 0.5]), st.integers(0, 120),
)  # fmt: skip
def test_round_equals_the_sequential_pass(mesh, edge_degrees, score, quantile, budget):
    vertices, faces, uvs, uv_faces, gradient = mesh
    choice = SplitSettings(edge_degrees=edge_degrees, score=score, area_quantile=quantile)
    halfedge, mu = plan_splits(vertices, faces, gradient, budget, choice)
    start = Topology(vertices, faces, uvs, uv_faces, VertexMap(), np.arange(len(faces)), 0)
    got, _ = apply_splits(start, halfedge, mu)
    p, f, uv, c = split_round(vertices, faces, uvs, uv_faces, gradient, budget, choice)

    assert len(got.vertices) == len(p)
    np.testing.assert_allclose(got.vertices, np.array(p), atol=1e-6)
    faces_got, corner_got, index_got = canonical(got.faces, got.uvs, got.uv_faces)
    faces_want, corner_want, index_want = canonical(f, uv, c)
    assert faces_got == faces_want
    np.testing.assert_allclose(corner_got, corner_want, atol=1e-6)
    assert same_sharing(index_got, index_want)


@settings(max_examples=40, deadline=None)
@given(meshes(), st.integers(1, 5), st.sampled_from(["score", "area", "random"]), st.booleans())
def test_split_keeps_topology_and_the_cap(mesh, factor, criterion, odd):
    vertices, faces, uvs, uv_faces, gradient = mesh
    target = len(faces) * factor + odd
    done = split(vertices, faces, uvs, uv_faces, gradient, target, SplitSettings(method=criterion), seed=3)
    assert len(faces) <= len(done.faces) <= target
    check_topology((vertices, faces, uvs, uv_faces), done)
    np.testing.assert_array_equal(done.vertices[: len(vertices)], vertices)
    np.testing.assert_allclose(
        face_areas(done.vertices, done.faces).sum(), face_areas(vertices, faces).sum(), rtol=1e-4
    )
    if is_closed(faces):
        volume = signed_volume(vertices, faces)
        np.testing.assert_allclose(signed_volume(done.vertices, done.faces), volume, rtol=1e-4, atol=1e-6)


@slow_but_few
@given(meshes(noise=(0.05,)), st.integers(0, 2**32 - 1))
def test_surface_points_keep_their_place_in_the_texture(mesh, seed):
    vertices, faces, uvs, uv_faces, gradient = mesh
    done = split(vertices, faces, uvs, uv_faces, gradient, 3 * len(faces), SplitSettings(area_quantile=0.0))
    rng = np.random.default_rng(seed)
    new = rng.integers(0, len(done.faces), 400)
    bary = rng.dirichlet([1, 1, 1], 400)
    point = np.einsum("nk,nkc->nc", bary, done.vertices[done.faces[new]].astype(np.float64))
    uv = np.einsum("nk,nkc->nc", bary, done.uvs[done.uv_faces[new]].astype(np.float64))
    old = done.face_source[new]
    a, b, c = (vertices[faces[old, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.einsum("ij,ij->i", normal, normal)
    fat = size > 1e-6
    w_b = np.einsum("ij,ij->i", np.cross(point - a, c - a), normal) / np.where(fat, size, 1)
    w_c = np.einsum("ij,ij->i", np.cross(b - a, point - a), normal) / np.where(fat, size, 1)
    weights = np.stack([1 - w_b - w_c, w_b, w_c], axis=1)
    assert weights[fat].min() > -1e-4
    want = np.einsum("nk,nkc->nc", weights, uvs[uv_faces[old]].astype(np.float64))
    np.testing.assert_allclose(uv[fat], want[fat], atol=2e-5)
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", weights, np.stack([a, b, c], 1))[fat], point[fat], atol=1e-5)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_split_does_not_depend_on_the_scale(name, scale):
    vertices, faces, uvs, uv_faces = unwrapped(name)
    rng = np.random.default_rng(5)
    vertices = vertices + rng.normal(size=vertices.shape).astype(np.float32) * np.float32(0.02)
    gradient = rng.random(len(vertices)).astype(np.float32)
    one = split(vertices, faces, uvs, uv_faces, gradient, 4 * len(faces))
    other = split(vertices * np.float32(scale), faces, uvs, uv_faces, gradient / scale, 4 * len(faces))
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(one.uv_faces, other.uv_faces)
    np.testing.assert_allclose(one.vertices * scale, other.vertices, rtol=1e-4, atol=1e-5 * scale)


def test_split_gives_the_same_bytes_again():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    gradient = np.random.default_rng(0).random(len(vertices)).astype(np.float32)
    runs = [split(vertices, faces, uvs, uv_faces, gradient, 1000) for _ in range(2)]
    for name in ("vertices", "faces", "uvs", "uv_faces", "face_source"):
        assert getattr(runs[0], name).tobytes() == getattr(runs[1], name).tobytes()


def test_seams_are_decided_by_index_not_by_distance():
    # Two triangles whose UVs coincide along the common edge but have indices of their own: an edge between islands.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0.5, -0.5, 0]], np.float32)
    faces = np.array([[0, 1, 2], [1, 0, 3]], np.int32)
    uvs = np.array([[0.2, 0.5], [0.8, 0.5], [0.5, 0.8], [0.2, 0.5], [0.8, 0.5], [0.5, 0.2]], np.float32)
    seam = np.array([[0, 1, 2], [4, 3, 5]], np.int32)
    whole = np.array([[0, 1, 2], [1, 0, 5]], np.int32)
    for corners, new in ((seam, 2), (whole, 1)):
        start = Topology(vertices, faces, uvs, corners, VertexMap(), np.arange(2), 0)
        done, parent = apply_splits(start, np.array([0]), np.array([0.25]))
        assert len(done.uvs) - len(uvs) == new
        np.testing.assert_allclose(done.vertices[4], [0.25, 0, 0])
        np.testing.assert_allclose(done.uvs[6:], [[0.35, 0.5]] * new, atol=1e-6)
        assert parent.tolist() == [0, 1, 0, 1]
        check_topology((vertices, faces, uvs, corners), replace(done, face_source=parent))


def test_new_vertex_is_the_mean_of_both_projections_and_bad_places_are_refused():
    faces = np.array([[0, 1, 2], [1, 0, 3]], np.int32)
    uvs = np.array([[0.2, 0.5], [0.8, 0.5], [0.5, 0.8], [0.5, 0.2]], np.float32)
    for x_c, x_d, mu in ((0.3, 0.5, 0.4), (0.9, 0.5, 0.7), (1.4, 0.4, None), (0.1, 0.2, None)):
        vertices = np.array([[0, 0, 0], [1, 0, 0], [x_c, 0.2, 0], [x_d, -0.2, 0]], np.float32)
        done = split(vertices, faces, uvs, faces, np.ones(4), 4, SplitSettings(area_quantile=0.0, max_degree=99))
        long_edge_split = [v for v in done.vertices[4:] if abs(v[1]) < 1e-6]
        if mu is None:
            assert not long_edge_split
        else:
            np.testing.assert_allclose(long_edge_split, [[mu, 0, 0]], atol=1e-6)


def test_boundary_edges_are_halved():
    vertices, faces = np.array([[0, 0, 0], [2, 0, 0], [0.2, 1, 0]], np.float32), np.array([[0, 1, 2]], np.int32)
    uvs = np.array([[0, 0], [1, 0], [0.1, 0.5]], np.float32)
    done = split(vertices, faces, uvs, faces, np.ones(3), 2, SplitSettings(area_quantile=0.0))
    np.testing.assert_allclose(done.vertices[3], 0.5 * (vertices[1] + vertices[2]) if len(done.faces) == 2 else 0)
    np.testing.assert_allclose(done.uvs[3], 0.5 * (uvs[1] + uvs[2]))


def test_high_gradient_is_refined_first():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    gradient = (vertices[:, 1] > 0.3).astype(np.float32)
    done = split(vertices, faces, uvs, uv_faces, gradient, len(faces) + 40)
    assert (done.vertices[len(vertices) :, 1] > 0.1).all()


def test_curved_faces_are_refined_first_when_gradients_agree():
    vertices, faces, uvs, uv_faces = unwrapped("sheet")
    vertices = vertices.copy()
    vertices[:, 1] = np.maximum(0.0, vertices[:, 0] - 0.5) ** 2  # flat left half, bent right half
    done = split(vertices, faces, uvs, uv_faces, np.zeros(len(vertices)), len(faces) + 10)
    assert (done.vertices[len(vertices) :, 0] >= 0.4).all()


def test_disallowed_faces_do_not_start_a_split():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    allowed = vertices[faces].mean(axis=1)[:, 0] > 0.5
    done = split(vertices, faces, uvs, uv_faces, np.ones(len(vertices)), 2 * len(faces), allowed=allowed)
    assert len(done.faces) > len(faces)
    assert done.vertices[len(vertices) :, 0].min() > 0.0


def test_curvature_is_exact_for_flat_and_bent_and_safe_without_area():
    vertices, faces = grid(4, 4)
    assert np.abs(face_curvature(vertices + np.float32(1e3), faces)).max() < 1e-12
    angle = 1e-6  # arccos of the cosine would give 0 or a thousand times too much here
    bent = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -np.cos(angle), np.sin(angle)]])
    np.testing.assert_allclose(face_curvature(bent, np.array([[0, 1, 2], [1, 0, 3]])), angle, rtol=1e-6)
    vertices, faces = icosphere(1)
    vertices[faces[0, 1]] = vertices[faces[0, 0]]
    got = face_curvature(vertices, faces)
    assert np.isfinite(got).all()
    np.testing.assert_allclose(got, curvature(vertices.astype(np.float64), faces.tolist()), atol=1e-12)


def test_uniform_splits_all_faces_or_none():
    mesh = unwrapped("sphere")
    gradient, uniform, n = np.zeros(len(mesh[0])), SplitSettings(method="uniform"), len(mesh[1])
    assert len(split(*mesh, gradient, 4 * n, uniform).faces) == 4 * n
    left = split(*mesh, gradient, 4 * n - 1, uniform)
    assert left.count == 0
    assert left.faces is mesh[1]


def test_split_refuses_arrays_that_do_not_fit():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    with pytest.raises(GeometryError, match="gradients"):
        split(vertices, faces, uvs, uv_faces, np.ones(3), 1000)
    with pytest.raises(ValidationError, match="method"):
        SplitSettings(method="best")
