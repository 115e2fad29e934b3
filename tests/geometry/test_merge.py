"""Vertex merging against its sequential definition, and what it must never break."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from topology_meshes import SHAPES, canonical, check_topology, meshes, same_sharing, unwrapped
from topology_reference import merge_round

from benchmarks.meshes import grid
from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import area_vectors, euler_characteristic, signed_volume
from exmesh_graph.geometry.merge import apply_merges, merge, plan_merges
from exmesh_graph.geometry.settings import MergeSettings
from exmesh_graph.geometry.split import split
from exmesh_graph.geometry.topology import Topology, VertexMap, degeneracy
from exmesh_graph.types.edges import is_closed, is_edge_manifold

EAGER = MergeSettings(min_faces=4, degenerate=0.3, area_quantile=0.9, min_cosine=0.2)
PAPER = EAGER.replaced(tries=1, checks="topology", uv="own")  # the paper's letter, and the link condition


@pytest.mark.thorough
@settings(max_examples=18, deadline=None)
@given(
    meshes(),
    st.sampled_from([MergeSettings(min_faces=4), EAGER, PAPER]),
    st.floats(0.0, 1.0),
    st.integers(0, 2**32 - 1),
)
def test_round_equals_the_sequential_pass(mesh, choice, unseen, seed):
    vertices, faces, uvs, uv_faces, _ = mesh
    seen = np.random.default_rng(seed).random(len(faces)) >= unseen
    start = Topology(vertices, faces, uvs, uv_faces, VertexMap(), np.arange(len(faces)), 0)
    plan = plan_merges(start, seen, choice)
    gone, live, corners = merge_round(vertices, faces, uvs, uv_faces, seen, choice)
    assert dict(zip(plan.removed.tolist(), plan.survivor.tolist(), strict=True)) == gone
    done = apply_merges(start, plan, own_uv=choice.uv == "own")
    kept = done.map.steps[0].kept
    faces_got, uv_got, index_got = canonical(kept[done.faces], done.uvs, done.uv_faces)
    faces_want, uv_want, index_want = canonical(live, uvs, corners)
    assert faces_got == faces_want
    np.testing.assert_array_equal(uv_got, uv_want)
    assert same_sharing(index_got, index_want)


@pytest.mark.thorough
@settings(max_examples=60, deadline=None)
@given(meshes(), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1), st.sampled_from(["degenerate", "random"]))
def test_merge_keeps_topology(mesh, unseen, seed, criterion):
    vertices, faces, uvs, uv_faces, gradient = mesh
    rendered = (np.random.default_rng(seed).random(len(faces)) >= unseen).astype(int)
    choice = MergeSettings(min_faces=4, degenerate=0.3, area_quantile=0.9, min_cosine=0.2, method=criterion)
    done = merge(vertices, faces, uvs, uv_faces, rendered, choice, seed=seed)
    check_topology((vertices, faces, uvs, uv_faces), done)
    assert len(done.faces) >= min(4, len(faces))
    assert len(done.vertices) == len(np.unique(done.faces))  # compact
    assert len(done.uvs) == len(np.unique(done.uv_faces))
    # survivors do not move, and attributes follow them
    np.testing.assert_array_equal(done.map.carry(vertices), done.vertices)
    assert done.map.carry(gradient).shape == (len(done.vertices),)
    # no UV coordinate is invented
    assert set(map(tuple, done.uvs.tolist())) <= set(map(tuple, uvs.tolist()))
    assert degeneracy(done.vertices, done.faces).min() >= degeneracy(vertices, faces).min() * (1 - 1e-4)


@pytest.mark.thorough
def test_fuzzed_splits_and_merges_stay_a_manifold():
    for name in ("sphere", "torus", "neck", "strip"):
        vertices, faces, uvs, uv_faces = unwrapped(name)
        rng, total = np.random.default_rng(11), 0
        for turn in range(12):
            before = (vertices, faces, uvs, uv_faces)
            done = split(*before, rng.random(len(vertices)), int(1.4 * len(faces)), seed=turn)
            check_topology(before, done)
            total += done.count
            before = (done.vertices, done.faces, done.uvs, done.uv_faces)
            rendered = (rng.random(len(done.faces)) > 0.5).astype(int)
            done = merge(*before, rendered, EAGER.replaced(min_faces=20))
            check_topology(before, done)
            total += done.count
            vertices, faces, uvs, uv_faces = done.vertices, done.faces, done.uvs, done.uv_faces
            vertices = vertices + rng.normal(size=vertices.shape).astype(np.float32) * np.float32(1e-3)
        assert total > 1000 or name != "sphere"


@settings(max_examples=30, deadline=None)
@given(meshes(), st.sampled_from(["degenerate", "random"]), st.sampled_from(["own", "survivor"]), st.integers(0, 99))
def test_without_tests_of_shape_the_mesh_stays_a_manifold(mesh, criterion, uv, seed):
    vertices, faces, uvs, uv_faces, _ = mesh
    choice = PAPER.replaced(method=criterion, uv=uv, share=1.0, area_quantile=1.0)
    done = merge(vertices, faces, uvs, uv_faces, np.zeros(len(faces), int), choice, seed=seed)
    assert is_edge_manifold(done.faces)
    assert euler_characteristic(done.faces) == euler_characteristic(faces)
    pairs = np.unique(np.stack([done.uv_faces.reshape(-1), done.faces.reshape(-1)], axis=1), axis=0)
    assert len(np.unique(pairs[:, 0])) == len(pairs)  # no UV belongs to two vertices
    assert len(done.uvs) == len(np.unique(done.uv_faces))


def test_own_uvs_leave_the_triangles_of_the_atlas_where_they_were():
    mesh = unwrapped("sphere")
    done = merge(*mesh, np.zeros(len(mesh[1]), int), PAPER.replaced(area_quantile=1.0))
    assert done.count > 0
    before = {tuple(sorted(map(tuple, triangle))) for triangle in mesh[2][mesh[3]].tolist()}
    after = {tuple(sorted(map(tuple, triangle))) for triangle in done.uvs[done.uv_faces].tolist()}
    assert after < before


def test_random_merging_takes_the_share_it_is_given():
    mesh = unwrapped("sphere")
    choice = PAPER.replaced(method="random", area_quantile=1.0)

    def faces_gone(share):
        done = [merge(*mesh, None, choice.replaced(share=share), seed=seed) for seed in range(20)]
        return sum(one.count for one in done) / (len(done) * len(mesh[1]))

    assert faces_gone(0.0) == 0
    assert faces_gone(0.01) == pytest.approx(0.01, rel=0.4)
    assert faces_gone(0.05) > 2.5 * faces_gone(0.01)  # not five times: neighbours exclude each other


def test_tetrahedron_is_left_alone():
    mesh = unwrapped("tetrahedron")
    done = merge(*mesh, np.zeros(4, int), MergeSettings(min_faces=4, area_quantile=1.0, min_cosine=-1.0))
    assert done.count == 0
    assert len(done.faces) == 4


def test_torus_neck_is_not_pinched():
    # every loop across the tube has three edges: collapsing one of them would pinch the tube
    vertices, faces, uvs, uv_faces = unwrapped("neck")
    choice = MergeSettings(min_faces=4, area_quantile=1.0, min_cosine=0.0)
    done = merge(vertices, faces, uvs, uv_faces, np.zeros(len(faces), int), choice)
    check_topology((vertices, faces, uvs, uv_faces), done)


def test_boundary_vertices_outlive_inner_ones():
    vertices, faces, uvs, uv_faces = unwrapped("sheet")
    rim = np.unique(np.concatenate([np.flatnonzero(np.isin(vertices[:, k], (0, 1))) for k in (0, 2)]))
    inner = np.setdiff1d(np.arange(len(vertices)), rim)
    vertices = vertices.copy()
    vertices[inner[0]] = vertices[rim[0]] + np.array([1e-3, 0, 1e-3], np.float32)  # slivers at a corner
    done = merge(vertices, faces, uvs, uv_faces, None, MergeSettings(min_faces=4))
    assert done.count >= 1
    kept = set(map(tuple, done.vertices.tolist()))
    assert all(tuple(v) in kept for v in vertices[rim].tolist())


def test_degenerate_faces_disappear():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    vertices = vertices.copy()
    rng = np.random.default_rng(2)
    for v in rng.choice(len(vertices), 12, replace=False):  # pull vertices almost onto a neighbour
        other = faces[(faces == v).any(axis=1)][0]
        other = other[other != v][0]
        vertices[v] = 0.98 * vertices[other] + 0.02 * vertices[v]
    before = (degeneracy(vertices, faces) < 0.05).sum()
    done = merge(vertices, faces, uvs, uv_faces, None, MergeSettings(min_faces=4, area_quantile=0.6))
    assert before >= 15
    assert (degeneracy(done.vertices, done.faces) < 0.05).sum() <= 0.1 * before
    assert is_closed(done.faces)
    assert abs(signed_volume(done.vertices, done.faces) / signed_volume(vertices, faces) - 1) < 0.02


def test_large_and_rendered_faces_stay():
    mesh = unwrapped("sphere")
    faces = mesh[1]
    assert merge(*mesh, np.ones(len(faces), int)).count == 0
    assert merge(*mesh).count == 0
    assert merge(*mesh, np.zeros(len(faces), int), MergeSettings(min_faces=len(faces))).count == 0
    assert merge(*mesh, np.zeros(len(faces), int), MergeSettings(area_quantile=1.0, min_faces=200)).count > 10


def test_no_face_turns_over():
    vertices, faces = grid(8, 8)
    rng = np.random.default_rng(4)
    inner = ~np.isin(vertices[:, [0, 2]], (0, 1)).any(axis=1)
    vertices[inner] += rng.uniform(-0.05, 0.05, (inner.sum(), 3)).astype(np.float32) * [1, 0, 1]
    vertices = vertices.astype(np.float32)
    uvs, choice = vertices[:, [2, 0]].copy(), MergeSettings(min_faces=4, area_quantile=1.0, min_cosine=0.0)
    done = merge(vertices, faces, uvs, faces, np.zeros(len(faces), int), choice.replaced(min_faces=30))
    assert done.count > 20
    assert (area_vectors(done.vertices, done.faces)[:, 1] > 0).all()
    # the texture does not slide: on a plane with an affine atlas every corner still agrees with its vertex
    np.testing.assert_array_equal(
        done.uvs[done.uv_faces].reshape(-1, 2), done.vertices[done.faces].reshape(-1, 3)[:, [2, 0]]
    )


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_merge_does_not_depend_on_the_scale(name, scale):
    vertices, faces, uvs, uv_faces = unwrapped(name)
    rng = np.random.default_rng(6)
    vertices = vertices + rng.normal(size=vertices.shape).astype(np.float32) * np.float32(0.02)
    rendered = rng.integers(0, 2, len(faces))
    one = merge(vertices, faces, uvs, uv_faces, rendered, EAGER)
    other = merge(vertices * np.float32(scale), faces, uvs, uv_faces, rendered, EAGER)
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(one.uv_faces, other.uv_faces)


def test_merge_gives_the_same_bytes_again():
    mesh = unwrapped("torus")
    rendered = np.random.default_rng(0).integers(0, 2, len(mesh[1]))
    runs = [merge(*mesh, rendered, EAGER) for _ in range(2)]
    for name in ("vertices", "faces", "uvs", "uv_faces", "face_source"):
        assert getattr(runs[0], name).tobytes() == getattr(runs[1], name).tobytes()


def test_merge_refuses_arrays_that_do_not_fit():
    mesh = unwrapped("sphere")
    with pytest.raises(GeometryError, match="contribution counts"):
        merge(*mesh, np.ones(3, int))
    with pytest.raises(ValidationError, match="method"):
        MergeSettings(method="best")
