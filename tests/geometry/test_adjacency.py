"""The edge table and the questions answered from it, against dictionaries and known surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from topology_reference import incidence

from benchmarks.meshes import grid, is_vertex_manifold, is_winding_consistent, tetrahedron, torus
from exmesh_graph.geometry import adjacency as adj
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types.edges import edges_of, is_closed, is_edge_manifold


@st.composite
def face_lists(draw):
    """Any triangles at all: non-manifold, of mixed winding, sharing everything, never naming a vertex twice."""
    n = draw(st.integers(3, 9))
    triangle = st.lists(st.integers(0, n - 1), min_size=3, max_size=3, unique=True)
    return np.array(draw(st.lists(triangle, min_size=1, max_size=25)), np.int32)


@settings(max_examples=100, deadline=None)
@given(face_lists())
def test_edge_table_equals_a_dictionary(faces):
    edges = edges_of(faces)
    expected, near = incidence(faces.tolist())
    assert edges.vertices.tolist() == [list(edge) for edge in sorted(expected)]
    for row, edge in enumerate(sorted(expected)):
        halfedges = sorted(3 * f + k for f, k in expected[edge])
        assert edges.count[row] == len(halfedges)
        assert edges.halfedges[row].tolist() == [*halfedges, -1][:2]
        assert edges.faces[row].tolist() == [h // 3 if h >= 0 else -1 for h in [*halfedges, -1][:2]]
        for h in halfedges:
            assert edges.face_edges[h // 3, h % 3] == row
    n = int(faces.max()) + 1
    assert adj.vertex_degrees(faces, n).tolist() == [len(near.get(v, ())) for v in range(n)]
    offsets, indices = adj.neighbours(faces, n)
    assert [indices[offsets[v] : offsets[v + 1]].tolist() for v in range(n)] == [
        sorted(near.get(v, ())) for v in range(n)
    ]
    offsets, around = adj.incident_faces(faces, n)
    assert [around[offsets[v] : offsets[v + 1]].tolist() for v in range(n)] == [
        [f for f, face in enumerate(faces.tolist()) if v in face] for v in range(n)
    ]
    assert is_edge_manifold(faces) == all(len(s) <= 2 for s in expected.values())
    assert is_closed(faces) == all(len(s) == 2 for s in expected.values())
    assert len(adj.boundary_edges(faces)) == sum(len(s) == 1 for s in expected.values())


@settings(max_examples=100, deadline=None)
@given(face_lists())
def test_components_equal_a_flood_fill(faces):
    expected, _ = incidence(faces.tolist())
    label = list(range(len(faces)))
    for _ in faces:
        for sides in expected.values():
            lowest = min(label[f] for f, _ in sides)
            for f, _ in sides:
                label[f] = lowest
    order = list(dict.fromkeys(label))
    assert adj.components(faces).tolist() == [order.index(x) for x in label]


@pytest.mark.parametrize(
    ("mesh", "closed", "euler", "loops"),
    [
        (tetrahedron(), True, 2, 0),
        (icosphere(2), True, 2, 0),
        (torus(7, 5), True, 0, 0),
        (grid(4, 3), False, 1, 14),
    ],
)
def test_known_surfaces(mesh, closed, euler, loops):
    vertices, faces = mesh
    assert is_edge_manifold(faces)
    assert is_vertex_manifold(faces)
    assert is_winding_consistent(faces)
    assert is_closed(faces) == closed
    assert adj.euler_characteristic(faces) == euler
    assert len(adj.boundary_edges(faces)) == loops
    assert adj.components(faces).max() == 0
    if closed:
        assert adj.signed_volume(vertices, faces) > 0
        assert adj.signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-adj.signed_volume(vertices, faces))


def test_figures_of_the_sphere():
    vertices, faces = icosphere(4, radius=2.0)
    assert adj.face_areas(vertices, faces).sum() == pytest.approx(16 * np.pi, rel=5e-3)
    assert adj.signed_volume(vertices + np.float32(100), faces) == pytest.approx(32 / 3 * np.pi, rel=5e-3)
    outward = vertices / 2.0
    for normals in (adj.area_weighted_normals, adj.angle_weighted_normals):
        assert np.einsum("ij,ij->i", normals(vertices, faces), outward).min() > 0.999
    assert np.einsum("ij,ij->i", adj.face_normals(vertices, faces), outward[faces].mean(axis=1)).min() > 0.99


def test_three_faces_on_an_edge_and_two_fans_at_a_vertex():
    fin = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert not is_edge_manifold(fin)
    bow_tie = np.array([[0, 1, 2], [0, 3, 4]])
    assert is_edge_manifold(bow_tie)
    assert not is_vertex_manifold(bow_tie)
    fans, vertex = adj.corner_fans(bow_tie)
    assert fans.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert vertex.tolist() == [0, 1, 2, 0, 3, 4]
    assert is_vertex_manifold(np.array([[0, 1, 2], [0, 2, 3]]))


def test_a_turned_face_breaks_the_winding_and_a_repeated_vertex_the_manifold():
    _, faces = icosphere(1)
    turned = faces.copy()
    turned[7] = turned[7][::-1]
    assert is_edge_manifold(turned)
    assert not is_winding_consistent(turned)
    assert not is_edge_manifold(np.array([[0, 1, 1]]))
    assert not is_closed(np.array([[0, 1, 1]]))


def test_faces_without_area_have_no_normal_and_no_nan():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 1, 1]])
    normals = adj.face_normals(vertices, faces)
    assert normals.tolist() == [[0, 0, 0], [0, 0, 1], [0, 0, 0]]
    assert adj.face_areas(vertices, faces).tolist() == [0.0, 1.0, 0.0]


def test_edge_lengths():
    vertices, faces = grid(1, 1)
    edges = edges_of(faces)
    assert sorted(adj.edge_lengths(vertices, edges)) == pytest.approx([1, 1, 1, 1, 2**0.5])


def test_weighting_by_angle_does_not_see_how_a_flat_side_is_cut():
    """A cube's corner: three sides of 90 degrees each, two of them cut through the corner and one not."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], np.float32)
    faces = np.array([[0, 2, 4], [0, 4, 1], [0, 1, 5], [0, 5, 3], [0, 3, 2], [3, 6, 2]])
    np.testing.assert_allclose(adj.angle_weighted_normals(vertices, faces)[0], -np.ones(3) / np.sqrt(3), atol=1e-12)
    assert np.ptp(adj.area_weighted_normals(vertices, faces)[0]) > 0.1  # area does
