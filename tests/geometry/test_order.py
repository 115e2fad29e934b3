"""A mesh put in an order by place: the same mesh, with what lies side by side nearer in memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from topology_meshes import meshes

from exmesh_graph.geometry.order import in_space_order, morton
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.split import split
from exmesh_graph.geometry.topology import Topology, VertexMap


def soup(mesh):
    """Each face by the places and UVs of its corners, [F, 3, 5]."""
    return np.concatenate([mesh.vertices[mesh.faces], mesh.uvs[mesh.uv_faces]], axis=-1)


@settings(max_examples=25, deadline=None)
@given(meshes(), st.integers(0, 40))
def test_it_is_the_same_mesh_and_everything_follows(mesh, more):
    vertices, faces, uvs, uv_faces, gradient = mesh
    done = split(vertices, faces, uvs, uv_faces, gradient, len(faces) + more)
    ordered = in_space_order(done)
    places = [np.argsort(morton(part.vertices[part.faces].mean(axis=1)), kind="stable") for part in (done, ordered)]
    assert np.array_equal(places[1], np.arange(len(ordered.faces)))
    assert np.array_equal(soup(done)[places[0]], soup(ordered))
    assert np.array_equal(done.face_source[places[0]], ordered.face_source)
    assert (ordered.faces.dtype, ordered.uv_faces.dtype) == (done.faces.dtype, done.uv_faces.dtype)
    assert np.array_equal(ordered.map.carry(vertices), ordered.vertices)
    carried = [np.c_[part.vertices, part.map.carry(gradient)] for part in (done, ordered)]
    assert np.array_equal(*(np.unique(part, axis=0) for part in carried))
    assert sorted(map(tuple, ordered.uvs.tolist())) == sorted(map(tuple, done.uvs.tolist()))
    again = in_space_order(ordered)
    assert np.array_equal(again.faces, ordered.faces)


def test_corners_of_a_face_come_nearer_in_memory():
    vertices, faces = icosphere(5, 1.0)
    mixed = np.random.default_rng(0).permutation(len(vertices))
    back = np.argsort(mixed)
    shuffled = Topology(
        vertices[mixed], back[faces].astype(np.int32), vertices[mixed][:, :2], back[faces].astype(np.int32),
        VertexMap(), np.arange(len(faces)), 0,
    )  # fmt: skip
    ordered = in_space_order(shuffled)
    spans = [np.median(np.ptp(part, axis=1)) for part in (shuffled.faces, ordered.faces)]
    assert spans[1] < 0.02 * spans[0]
    assert np.median(np.abs(np.diff(ordered.faces[:, 0]))) < 0.01 * len(vertices)


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.eye(3), np.array([[0.0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]])])
def test_the_curve_by_single_bits(points):
    side = max(np.ptp(points, axis=0).max(), 1e-30)
    for point, code in zip(points, morton(points).tolist(), strict=True):
        cells = [min(int((x - low) / side * 1024), 1023) for x, low in zip(point, points.min(axis=0), strict=True)]
        bits = "".join(f"{cells[axis]:010b}"[-1 - bit] for bit in range(9, -1, -1) for axis in (2, 1, 0))
        assert code == int(bits, 2)


def test_nothing_is_left_as_it_is():
    empty = np.zeros((0, 3), np.int32)
    mesh = Topology(np.zeros((0, 3)), empty, np.zeros((0, 2)), empty, VertexMap(), np.arange(0), 0)
    assert in_space_order(mesh) is mesh
