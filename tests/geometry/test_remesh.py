"""The remesher and the repairs: topology kept, budget met, surface kept, defects mended."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.meshes import grid, is_vertex_manifold, is_winding_consistent, tetrahedron, torus
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh, squared_distance
from exmesh_graph.geometry.adjacency import euler_characteristic, face_areas
from exmesh_graph.geometry.clean import largest_components, weld
from exmesh_graph.geometry.hull import Grid, surface
from exmesh_graph.geometry.remesh import _sharpness, _spread, remesh
from exmesh_graph.geometry.repair import drop_crowding_faces, fill_holes, make_manifold, orient
from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.geometry.soundness import inspect
from exmesh_graph.geometry.surface import closest_on_triangles
from exmesh_graph.types.edges import edges_of, is_closed


@pytest.mark.thorough
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), budget=st.sampled_from([120, 400, 3000]))
def test_noisy_spheres_keep_their_topology(seed, budget):
    rng = np.random.default_rng(seed)
    vertices, faces = icosphere(3)
    vertices = vertices * (1 + 0.03 * rng.normal(size=(len(vertices), 1))) * rng.uniform(0.3, 2, 3)
    v, f = remesh(vertices, faces, budget)
    assert len(f) <= budget
    assert is_closed(f)
    assert is_vertex_manifold(f)
    assert is_winding_consistent(f)
    assert euler_characteristic(f) == 2
    found = inspect(v, f)
    assert found.duplicate_faces == found.flat_faces == found.unreferenced == 0
    assert distance_to_mesh(v, vertices, faces).max() < 1e-6


@pytest.mark.thorough
@pytest.mark.parametrize("budget", [300, 5000])
def test_torus(budget):
    v, f = remesh(*torus(40, 20), budget)
    assert 0.8 * budget <= len(f) <= budget
    assert euler_characteristic(f) == 0
    edges = np.linalg.norm(v[f] - v[np.roll(f, 1, axis=1)], axis=2)
    assert edges.std() / edges.mean() < 0.25


def test_open_meshes_keep_their_boundary():
    vertices, faces = grid(12, 12)
    v, f = remesh(vertices, faces, 200)
    assert euler_characteristic(f) == 1
    assert v.min(0) == pytest.approx(vertices.min(0))
    assert v.max(0) == pytest.approx(vertices.max(0))


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
def test_a_long_fine_boundary_fits_the_budget_and_stays_near(seed):
    """A sheet whose border frays: one face in two is gone from its outermost row, all around."""
    rng = np.random.default_rng(seed)
    vertices, faces = grid(40, 40)
    low, span = vertices.min(0), np.ptp(vertices, axis=0)
    plane = span > 0
    share = ((vertices[faces].mean(1) - low)[:, plane]) / span[plane]
    edge = np.minimum(share, 1 - share).min(1)
    vertices = vertices + 0.002 * rng.normal(size=vertices.shape) * ~plane
    vertices, faces = weld(vertices, faces[(edge > 1 / 60) | (rng.random(len(faces)) > 0.5)])
    vertices, faces = make_manifold(*largest_components(vertices, faces, 1))
    v, f = remesh(vertices, faces, 300)
    assert len(f) <= 300
    assert euler_characteristic(f) == euler_characteristic(faces)
    assert is_vertex_manifold(f)
    assert is_winding_consistent(f)
    assert inspect(v, f).flat_faces == 0
    length = np.sqrt(4 * span[plane].prod() / np.sqrt(3) / 300)
    assert distance_to_mesh(v, vertices, faces).max() < 0.1 * length
    assert np.quantile(distance_to_mesh(vertices, v, f), 0.99) < 0.6 * length


def test_nothing_to_collapse():
    _, f = remesh(*tetrahedron(), 4)
    assert is_closed(f)
    assert len(f) >= 4


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_closest_point_is_as_near_as_the_distance_says(seed):
    rng = np.random.default_rng(seed)
    points, corners = rng.normal(size=(20, 3)), rng.normal(size=(20, 3, 3))
    found = closest_on_triangles(points, corners)
    assert ((found - points) ** 2).sum(1) == pytest.approx(squared_distance(points, corners), abs=1e-12)
    assert squared_distance(found, corners) == pytest.approx(0, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_shuffled_windings_are_made_alike(seed):
    rng = np.random.default_rng(seed)
    _, faces = torus(9, 7)
    flip = rng.random(len(faces)) < 0.5
    shuffled = np.where(flip[:, None], faces[:, ::-1], faces)
    assert not is_winding_consistent(shuffled)
    assert is_winding_consistent(orient(shuffled))


def test_crowded_edges_keep_their_two_largest_faces():
    vertices, faces = icosphere(1)
    fin = np.vstack([vertices, vertices[faces[0, 0]] * 1.01])
    finned = np.vstack([faces, [faces[0, 0], faces[0, 1], len(vertices)]])
    assert np.array_equal(drop_crowding_faces(fin, finned), faces)


def test_pinched_vertices_are_doubled():
    vertices, faces = tetrahedron()
    both = np.vstack([vertices, 2 * vertices[0] - vertices[1:]])
    mirrored = np.where(faces == 0, 0, faces + 3)[:, ::-1]
    pinched = np.vstack([faces, mirrored])
    assert not is_vertex_manifold(pinched)
    v, f = make_manifold(both, pinched)
    assert is_vertex_manifold(f)
    assert len(v) == 8


def test_small_holes_are_closed_and_large_ones_left():
    vertices, faces = icosphere(2)
    star = np.flatnonzero((faces == 0).any(1))
    _, f = fill_holes(vertices, np.delete(faces, star, axis=0), len(star))
    assert is_closed(f)
    assert is_winding_consistent(f)
    _, still = fill_holes(vertices, np.delete(faces, star, axis=0), len(star) - 1)
    assert not is_closed(still)


def test_vertices_that_fell_together_are_spread_and_others_stay():
    vertices, faces = icosphere(2)
    fallen = vertices.astype(np.float64)
    a, b = faces[7, :2]
    fallen[a] = fallen[b]
    assert inspect(fallen, faces).flat_faces == 2
    spread = _spread(fallen, faces, 4 * np.pi / len(faces))
    assert inspect(spread, faces).flat_faces == 0
    near = np.unique(faces[(faces == a).any(1) & (faces == b).any(1)])
    assert np.array_equal(np.delete(spread, near, axis=0), np.delete(fallen, near, axis=0))
    assert np.linalg.norm(spread - fallen, axis=1).max() < 0.3


def plate(resolution=96):
    """A square of side 1.2, a thirtieth as thick, tilted, as marching cubes bring it out."""
    grid_ = Grid.over(np.full(3, -1.0), np.full(3, 1.0), resolution)
    points = grid_.points() @ np.linalg.qr(np.array([[3.0, 1, 1], [0, 2, 1], [1, 0, 2]]))[0]
    values = np.minimum(0.02 - np.abs(points[:, 0]), 0.6 - np.abs(points[:, 1:]).max(1))
    return surface(values.reshape(grid_.shape), grid_)


@pytest.mark.thorough
@pytest.mark.parametrize("budget", [150, 600])
def test_a_thin_sheet_keeps_its_rim(budget):
    v, f = plate()
    area = face_areas(v, f).sum()
    thin, few = remesh(v, f, budget)
    assert is_closed(few)
    assert euler_characteristic(few) == 2
    assert face_areas(thin, few).sum() > 0.9 * area
    assert np.ptp(thin, axis=0) == pytest.approx(np.ptp(v, axis=0), abs=0.12)


def test_sharpness_of_a_box():
    """The middles of its edges are on one crease between their neighbours, its corners are corners."""
    v, f = box_of(4)
    rank, beside = _sharpness(v, f, edges_of(f))
    extreme = (np.abs(v) == 1).sum(1)
    np.testing.assert_array_equal(rank, np.maximum(extreme - 1, 0))
    on = rank == 1
    np.testing.assert_allclose(v[beside[on]].mean(1), v[on], atol=1e-6)


def box_of(n):
    """The cube [-1, 1]^3 with n x n squares a side."""
    sheet, cells = grid(n, n)
    flat = 2 * (sheet - sheet.min(0))[:, np.ptp(sheet, axis=0) > 0] / np.ptp(sheet, axis=0).max() - 1
    sides = []
    for axis in range(3):
        for end in (-1.0, 1.0):
            sides.append(np.insert(flat, axis, end, axis=1))
    faces = np.concatenate([cells + k * len(flat) for k in range(6)])
    v, f = weld(np.concatenate(sides), faces)
    return v, orient(f)
