"""Edge flips against their sequential definition, and what they must never change."""

from __future__ import annotations

import numpy as np
import pytest
from flip_reference import flip_round
from hypothesis import given, settings
from hypothesis import strategies as st
from topology_meshes import SHAPES, canonical, check_topology, meshes, same_sharing, unwrapped

from benchmarks.mesh_quality import mesh_quality
from benchmarks.meshes import grid
from exmesh_graph.geometry.adjacency import boundary_edges
from exmesh_graph.geometry.flip import flip
from exmesh_graph.geometry.settings import FlipSettings
from exmesh_graph.geometry.split import split

BOLD = FlipSettings(max_bend=1.2, max_shift=0.5, min_shape=0.02)
CHOICES = [FlipSettings(), BOLD, FlipSettings(method="valence"), BOLD.replaced(method="valence")]


@pytest.mark.thorough
@settings(max_examples=15, deadline=None)
@given(meshes(), st.sampled_from(CHOICES), st.integers(1, 3))
def test_rounds_equal_the_sequential_pass(mesh, choice, rounds):
    vertices, faces, uvs, uv_faces, _ = mesh
    done = flip(vertices, faces, uvs, uv_faces, choice.replaced(max_rounds=rounds))
    want_faces, want_corners = faces, uv_faces
    for _ in range(rounds):
        want_faces, want_corners = flip_round(vertices, want_faces, uvs, want_corners, choice)
    got, want = canonical(done.faces, uvs, done.uv_faces), canonical(want_faces, uvs, want_corners)
    assert got[0] == want[0]
    np.testing.assert_array_equal(got[1], want[1])
    assert same_sharing(got[2], want[2])


@pytest.mark.thorough
@settings(max_examples=40, deadline=None)
@given(meshes(), st.sampled_from(CHOICES), st.integers(0, 2**32 - 1))
def test_flips_keep_topology_and_what_they_do_not_own(mesh, choice, seed):
    before = mesh[:4]
    grown = split(*before, mesh[4], 2 * len(mesh[1]), seed=seed)
    before = (grown.vertices, grown.faces, grown.uvs, grown.uv_faces)
    done = flip(*before, choice)
    check_topology(before, done)
    assert len(done.faces) == len(before[1])
    assert done.vertices is before[0]
    assert done.uvs is before[2]
    for table, old in ((done.faces, before[1]), (done.uv_faces, before[3])):  # outline and seams are where they were
        one, other = (set(map(tuple, boundary_edges(x).tolist())) for x in (table, old))
        assert one == other
    again = flip(*before, choice)
    assert done.faces.tobytes() == again.faces.tobytes()


def test_delaunay_flips_end_without_an_edge_to_flip_on_a_plane():
    """Lawson: on a convex planar domain flips reach the triangulation of empty circumcircles."""
    vertices, faces = grid(7, 7)
    rng = np.random.default_rng(3)
    inner = ~np.isin(vertices[:, [0, 2]], (0, 1)).any(axis=1)
    vertices[inner] += (rng.uniform(-0.06, 0.06, (inner.sum(), 3)) * [1, 0, 1]).astype(np.float32)
    uvs = vertices[:, [2, 0]].copy()
    done = flip(vertices, faces, uvs, faces, FlipSettings(min_shape=0.0, max_rounds=50))
    assert done.count > 5
    p = vertices[:, [2, 0]].astype(np.float64)
    for face in done.faces:
        a, b, c = p[face]
        for d in np.delete(p, face, axis=0):
            rows = [[*(x - d), float((x - d) @ (x - d))] for x in (a, b, c)]
            assert np.linalg.det(rows) < 1e-7
    # an affine atlas on a plane: every corner still agrees with its vertex, so no colour has moved
    np.testing.assert_array_equal(done.uvs[done.uv_faces], p.astype(np.float32)[done.faces])


def test_texture_and_surface_move_less_than_the_settings_allow():
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    grown = split(vertices, faces, uvs, uv_faces, np.ones(len(vertices)), 1500)
    round_again = grown.vertices / np.linalg.norm(grown.vertices, axis=1, keepdims=True)  # no pair is coplanar
    before = (round_again, grown.faces, grown.uvs, grown.uv_faces)
    assert flip(*before).count > 50
    assert flip(*before, FlipSettings(max_shift=0.0)).count < flip(*before).count
    assert flip(*before, FlipSettings(max_bend=1e-4)).count == 0


@pytest.mark.parametrize(("criterion", "figure"), [("delaunay", "min_angle_mean"), ("valence", "degree_std")])
def test_flips_even_out_what_splits_have_scattered(criterion, figure):
    vertices, faces, uvs, uv_faces = unwrapped("sphere")
    gradient = np.random.default_rng(0).random(len(vertices))
    done = split(vertices, faces, uvs, uv_faces, gradient, 2000)
    before = mesh_quality(done.vertices, done.faces)
    flipped = flip(done.vertices, done.faces, done.uvs, done.uv_faces, FlipSettings(method=criterion))
    after = mesh_quality(flipped.vertices, flipped.faces)
    assert after["degree_std"] < (0.8 if criterion == "delaunay" else 0.7) * before["degree_std"]
    assert after[figure] > before[figure] + 2 if criterion == "delaunay" else after[figure] < 1.0


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_flips_do_not_depend_on_the_scale(name, scale):
    vertices, faces, uvs, uv_faces = unwrapped(name)
    rng = np.random.default_rng(6)
    vertices = vertices + rng.normal(size=vertices.shape).astype(np.float32) * np.float32(0.03)
    one = flip(vertices, faces, uvs, uv_faces, BOLD)
    other = flip(vertices * np.float32(scale), faces, uvs, uv_faces, BOLD)
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(one.uv_faces, other.uv_faces)
