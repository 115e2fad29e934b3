"""Distances between meshes with known answers, and the report on a mesh."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.errors import GeometryError
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh, distance_to_mesh_plain, squared_distance
from exmesh_graph.evaluate.metrics.mesh import (
    bounding_radius,
    chamfer,
    count_self_intersections,
    folded_share,
    mesh_report,
)
from exmesh_graph.geometry.hull import Grid, surface
from exmesh_graph.gpu.cores import cores

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def nearest_by_minimisation(point, corners):
    """Reference: the minimum over a fine barycentric grid, refined around its best entry."""
    centre, half = np.array([1 / 3, 1 / 3]), 1.0
    for _ in range(30):
        grid = np.linspace(-half, half, 9)
        u, v = (g.ravel() for g in np.meshgrid(centre[0] + grid, centre[1] + grid))
        u, v = np.clip(u, 0, 1), np.clip(v, 0, 1)
        v = np.minimum(v, 1 - u)
        points = corners[0] + u[:, None] * (corners[1] - corners[0]) + v[:, None] * (corners[2] - corners[0])
        best = ((points - point) ** 2).sum(1).argmin()
        centre, half = np.array([u[best], v[best]]), half * 0.6
    return np.linalg.norm(points[best] - point)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), flat=st.booleans())
def test_point_to_triangle(seed, flat):
    rng = np.random.default_rng(seed)
    corners, point = rng.normal(size=(3, 3)), rng.normal(size=3) * 2
    if flat:
        corners[2] = corners[0] + 0.3 * (corners[1] - corners[0])
    got = np.sqrt(squared_distance(point[None], corners[None])[0])
    assert got == pytest.approx(nearest_by_minimisation(point, corners), abs=1e-4)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 1.0, 3.0]))
def test_distance_equals_brute_force(seed, spread):
    """Soups of triangles whose sizes span several powers of ten, some of them degenerate."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-spread, 0, (60, 1, 1))
    corners = rng.normal(size=(60, 1, 3)) + size * rng.normal(size=(60, 3, 3))
    corners[0, 1] = corners[0, 0]
    corners[1] = corners[1, :1]
    points = 2 * rng.normal(size=(50, 3))
    faces = np.arange(180).reshape(60, 3)
    all_pairs = squared_distance(np.repeat(points, 60, 0), np.tile(corners, (50, 1, 1))).reshape(50, 60)
    soup, expected = corners.reshape(-1, 3), np.sqrt(all_pairs.min(1))
    assert distance_to_mesh_plain(points, soup, faces) == pytest.approx(expected, abs=1e-12)
    beyond = (distance_to_mesh(points, soup, faces) - expected) / bounding_radius(soup)
    assert beyond.min() > -1e-12
    assert beyond.max() < 2e-6


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), thin=st.floats(0, 5), away=st.sampled_from([0.0, 1e4]), only=st.booleans())
def test_distance_to_needles(seed, thin, away, only):
    """Long thin triangles, down to lines, which float32 alone misses; near a mesh and far from the origin."""
    rng = np.random.default_rng(seed)
    start, along, across = rng.normal(size=(3, 40, 3))
    corners = np.stack([start, start + along, start + 0.5 * along + 10.0**-thin * across], axis=1)
    corners = (corners if only else np.concatenate([corners, rng.normal(size=(40, 3, 3))])) + away
    weight = rng.dirichlet([1, 1, 1], 200)
    near = np.einsum("pk,pkx->px", weight, corners[rng.integers(0, len(corners), 200)])
    points = near + 10 ** rng.uniform(-6, 1, (200, 1)) * rng.normal(size=(200, 3))
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    expected = distance_to_mesh_plain(points, corners.reshape(-1, 3), faces)
    beyond = (distance_to_mesh(points, corners.reshape(-1, 3), faces) - expected) / bounding_radius(corners[:, 0])
    assert beyond.min() > -1e-9
    assert beyond.max() < 2e-6


def test_distance_is_the_same_for_any_number_of_cores():
    rng = np.random.default_rng(3)
    points, (vertices, faces) = rng.normal(size=(20_000, 3)), ball(0.8)
    with cores(1):
        alone = distance_to_mesh(points, vertices, faces)
    for count in (2, 3):
        with cores(count):
            assert np.array_equal(distance_to_mesh(points, vertices, faces), alone)


def test_distance_names_a_vertex_that_is_not_finite():
    broken = CUBE.copy()
    broken[5, 1] = np.nan
    with pytest.raises(GeometryError, match="not finite") as caught:
        distance_to_mesh(CUBE, broken, CUBE_FACES)
    assert "vertex 5" in str(caught.value)


def test_distance_to_a_cube():
    points = np.array([[0.5, 0.5, 0.5], [2, 0.5, 0.5], [2, 2, 0.5], [2, 2, 2], [0.5, 0.5, 1], [-3, 0.2, 0.1]])
    expected = [0.5, 1, 2**0.5, 3**0.5, 0, 3]
    assert distance_to_mesh(points, CUBE, CUBE_FACES) == pytest.approx(expected)


def test_distance_equals_open3d():
    from exmesh_graph.native import import_open3d

    o3d = import_open3d()
    rng = np.random.default_rng(0)
    vertices, faces = rng.normal(size=(300, 3)), rng.integers(0, 300, (500, 3))
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    points = rng.normal(size=(2000, 3))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    expected = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
    assert distance_to_mesh(points, vertices, faces) == pytest.approx(expected, abs=2e-6)


def ball(radius, resolution=24):
    grid = Grid.over(np.full(3, -1.0), np.full(3, 1.0), resolution)
    vertices, faces = surface((radius - np.linalg.norm(grid.points(), axis=1)).reshape(grid.shape), grid)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True) * radius, faces


def test_chamfer_of_spheres_is_the_difference_of_radii():
    result = chamfer(*ball(0.8), *ball(0.7), samples=4000)
    assert result.chamfer == pytest.approx(0.1, abs=0.004)
    assert result.accuracy == pytest.approx(0.1, abs=0.004)
    assert result.completeness == pytest.approx(0.1, abs=0.004)
    assert result.p95 == pytest.approx(0.1, abs=0.01)
    assert chamfer(*ball(0.8), *ball(0.8), samples=1000).max < 1e-7


def test_the_two_directions_tell_missing_from_extra_parts():
    lower = CUBE * [1, 0.5, 1]
    result = chamfer(lower, CUBE_FACES, CUBE, CUBE_FACES, samples=8000)
    # From the half cube (area 4): its lid (area 1) lies inside the cube at the height 1/2.
    # From the cube (area 6): lid at 1/2, and four walls of area 1/2 at mean height 1/4.
    lid = np.mean([min(0.5, x, 1 - x, z, 1 - z) for x in np.linspace(0, 1, 101) for z in np.linspace(0, 1, 101)])
    assert result.accuracy == pytest.approx(lid / 4, rel=0.05)
    assert result.completeness == pytest.approx((0.5 + 2 * 0.25) / 6, rel=0.02)
    assert result.chamfer == pytest.approx((result.accuracy + result.completeness) / 2)
    swapped = chamfer(CUBE, CUBE_FACES, lower, CUBE_FACES, samples=8000)
    assert swapped.accuracy == pytest.approx(result.completeness, rel=0.02)


def test_figures_are_seeded_and_scale():
    a, b = (chamfer(*ball(0.8), CUBE, CUBE_FACES, samples=500, seed=4) for _ in range(2))
    assert a == b
    assert a != chamfer(*ball(0.8), CUBE, CUBE_FACES, samples=500, seed=5)
    assert a.scaled(0.5)["p95"] == a.p95 / 2
    assert a.scaled(0.5)["samples"] == 500


def test_bounding_radius():
    assert bounding_radius(CUBE + 7) == pytest.approx(np.sqrt(3) / 2)
    assert bounding_radius(ball(0.8)[0]) == pytest.approx(0.8, rel=0.01)
    with pytest.raises(GeometryError):
        bounding_radius(np.zeros((0, 3)))


def test_empty_meshes():
    with pytest.raises(GeometryError, match="area 0"):
        chamfer(CUBE, CUBE_FACES[:0], CUBE, CUBE_FACES)
    with pytest.raises(GeometryError, match="without faces"):
        distance_to_mesh(CUBE, CUBE, CUBE_FACES[:0])


class TestReport:
    def test_cube(self):
        report = mesh_report(CUBE, CUBE_FACES)
        assert (report["vertices"], report["faces"], report["components"]) == (8, 12, 1)
        assert report["closed"]
        assert report["edge_manifold"]
        assert report["genus"] == 0
        assert report["area"] == pytest.approx(6)
        assert report["volume"] == pytest.approx(1)
        assert report["folded"] == 0

    def test_two_parts_and_a_torus(self):
        report = mesh_report(np.vstack([CUBE, CUBE + 3]), np.vstack([CUBE_FACES, CUBE_FACES + 8]))
        assert (report["components"], report["genus"], report["euler"]) == (2, 0, 4)
        grid = Grid.over(np.full(3, -1.0), np.full(3, 1.0), 24)
        x, y, z = grid.points().T
        torus = surface((0.25 - np.hypot(np.hypot(x, z) - 0.6, y)).reshape(grid.shape), grid)
        assert mesh_report(*torus)["genus"] == 1

    def test_open_and_crowded(self):
        report = mesh_report(CUBE, CUBE_FACES[:-1])
        assert not report["closed"]
        assert report["genus"] is None
        assert report["volume"] is None
        assert not mesh_report(CUBE, np.vstack([CUBE_FACES, [[0, 1, 6]]]))["edge_manifold"]

    def test_folds(self):
        flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
        assert folded_share(flat, np.array([[0, 1, 2], [2, 1, 3]])) == 0
        flat[3] = [0.1, 0.1, 0.01]
        assert folded_share(flat, np.array([[0, 1, 2], [2, 1, 3]])) == 1

    def test_self_intersections(self):
        vertices = np.vstack([CUBE, CUBE + np.array([0.5, 0.25, 0.3])])
        assert count_self_intersections(vertices, np.vstack([CUBE_FACES, CUBE_FACES + 8])) > 0
        assert count_self_intersections(CUBE, CUBE_FACES) == 0
        report = mesh_report(CUBE, CUBE_FACES, self_intersections=True)
        assert report["self_intersections"] == 0
