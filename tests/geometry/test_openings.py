"""Lids and what may lie behind them: against shapes whose mouths, walls and depths are known."""

import numpy as np
import pytest

from exmesh_graph.geometry.hull import Grid, surface
from exmesh_graph.geometry.lids import lids
from exmesh_graph.geometry.openings import Lidded, apart, best_opening, opened, without

RADIUS, HALF = 0.5, 0.6


def grid_of(cells=40):
    return Grid(np.full(3, -0.8), 1.6 / cells, (cells + 1,) * 3)


def drum(grid, radius=RADIUS, half=HALF):
    """A solid cylinder around the Y axis."""
    x, y, z = grid.points().reshape(*grid.shape, 3).transpose(3, 0, 1, 2)
    return np.minimum(radius - np.hypot(x, z), half - np.abs(y)).astype(np.float32)


def ball(grid):
    return (0.6 - np.linalg.norm(grid.points(), axis=1)).reshape(grid.shape)


def block(grid):
    low = np.abs(grid.points()) * [1, 1.4, 2]
    return (0.6 - low.max(axis=1)).reshape(grid.shape).astype(np.float32)


@pytest.fixture(scope="module")
def vessel():
    grid = grid_of()
    values = drum(grid)
    mesh = surface(values, grid)
    top = next(lid for lid in lids(values, grid, *mesh) if lid.normal[1] > 0.9)
    return values, grid, mesh, top


@pytest.mark.parametrize(("shape", "count"), [(drum, 2), (ball, 0), (block, 6)])
def test_flat_parts_that_end_in_creases_are_lids(shape, count):
    grid = grid_of()
    values = shape(grid)
    found = lids(values, grid, *surface(values, grid))
    assert len(found) == count
    for one in found:
        assert np.abs(one.normal).max() > 0.99
        assert [lid.radius for lid in found] == sorted((lid.radius for lid in found), reverse=True)


def test_a_lid_knows_its_middle_and_its_size(vessel):
    _, grid, mesh, top = vessel
    np.testing.assert_allclose(top.middle, [0, HALF, 0], atol=grid.step / 2)
    assert top.radius == pytest.approx(RADIUS, abs=2 * grid.step)
    assert mesh[0][mesh[1][top.faces]].mean(1)[:, 1].min() > HALF - 2 * grid.step


@pytest.mark.parametrize(("wall", "depth"), [(0.1, 0.3), (0.2, 0.9), (0.05, 3.0)])
def test_an_opening_follows_the_outside_at_the_walls_thickness(vessel, wall, depth):
    """By brute force: how far each point of the grid is from every face beside the lid."""
    values, grid, (vertices, faces), top = vessel
    opening = Lidded(values, grid, vertices, faces, top).opening(wall, depth)
    others = np.delete(vertices[faces].mean(1), top.faces, axis=0)
    points = grid.points()[::7]
    points = points[(values.ravel()[::7] > grid.step) & (points[:, 1] < HALF - 3 * grid.step)]
    apart = np.array([np.linalg.norm(others - point, axis=1).min() for point in points])
    expected = np.minimum(apart - wall, depth - (HALF - points[:, 1]))
    np.testing.assert_allclose(opening(points), expected, atol=0.75 * grid.step)


def test_a_ray_leaves_an_opening_where_it_meets_wall_or_bottom(vessel):
    values, grid, mesh, top = vessel
    opening = Lidded(values, grid, *mesh, top).opening(0.1, 0.5)
    rng = np.random.default_rng(3)
    aims = np.column_stack([rng.uniform(-0.33, 0.33, 40), np.full(40, HALF), rng.uniform(-0.33, 0.33, 40)])
    eyes = np.column_stack([rng.uniform(-1, 1, 40), np.full(40, 3.0), rng.uniform(-1, 1, 40)])
    rays = (aims - eyes) / 2
    out = opening.exits(eyes, rays, np.full(40, 2.0))
    fine = 2 + np.arange(4000) * 2e-4
    inside = opening((eyes[:, None] + fine[:, None] * rays[:, None]).reshape(-1, 3)).reshape(40, -1) > 0
    entered = np.maximum.accumulate(inside, axis=1)
    expected = fine[(entered & ~inside).argmax(axis=1)]
    np.testing.assert_allclose(out, expected, atol=0.5 * grid.step)


def test_a_ray_that_misses_the_opening_ends_where_it_began(vessel):
    values, grid, mesh, top = vessel
    opening = Lidded(values, grid, *mesh, top).opening(0.2, 0.5)
    out = opening.exits(np.array([[0.45, 3.0, 0.0]]), np.array([[0.0, -1.2, 0.0]]), np.array([2.0]))
    np.testing.assert_array_equal(out, [2.0])


@pytest.mark.parametrize("cells", [40, 64])
def test_what_is_opened_is_one_closed_vessel(vessel, cells):
    values, grid, mesh, top = vessel
    opening = Lidded(values, grid, *mesh, top).opening(0.12, 0.7)
    fine = grid_of(cells)
    hollow = without(drum(fine), fine, [opening])
    taken = ((drum(fine) > 0) & (hollow <= 0)).sum() * fine.step**3
    assert taken == pytest.approx(np.pi * (RADIUS - 0.12) ** 2 * 0.7, rel=0.08)
    vertices, faces = opened(drum(fine), fine, [opening])
    assert len(vertices) - len(faces) / 2 == 2  # a sphere's
    middle = np.hypot(vertices[:, 0], vertices[:, 2]) < 0.25
    assert vertices[middle & (vertices[:, 1] > -0.5), 1].max() == pytest.approx(HALF - 0.7, abs=2 * fine.step)


def test_no_opening_where_the_wall_leaves_no_room(vessel):
    values, grid, mesh, top = vessel
    assert Lidded(values, grid, *mesh, top).opening(0.49, 1.0) is None


@pytest.mark.parametrize(("wall", "depth"), [(0.08, 0.35), (0.2, 0.9)])
def test_the_best_opening_is_looked_for_between_those_tried_first(vessel, wall, depth):
    lidded = Lidded(*vessel[:2], *vessel[2], vessel[3])

    def gain(one):
        return 1 - abs(np.log(one.wall / wall)) - abs(np.log(one.depth / depth))

    found = best_opening(lidded, gain)
    assert found.wall == pytest.approx(wall, rel=0.2)
    assert found.depth == pytest.approx(depth, rel=0.2)


def test_of_openings_that_gain_alike_the_least_is_it(vessel):
    lidded = Lidded(*vessel[:2], *vessel[2], vessel[3])
    found = best_opening(lidded, lambda one: 0.3 if one.depth > 0.4 else 0.1)
    assert found.depth < 0.6
    assert best_opening(lidded, lambda one: 0.02) is None


@pytest.mark.parametrize("length", ["depth", "wall"])
def test_what_gains_the_more_the_shallower_or_thinner_it_is_is_no_vessel(vessel, length):
    lidded = Lidded(*vessel[:2], *vessel[2], vessel[3])
    assert best_opening(lidded, lambda one: 0.3 - 0.1 * getattr(one, length)) is None


def test_parts_that_meet_an_opening_are_told_from_those_apart():
    grid = grid_of(48)
    values = drum(grid)
    mesh = surface(values, grid)
    top = next(lid for lid in lids(values, grid, *mesh) if lid.normal[1] > 0.9)
    mouth = Lidded(values, grid, *mesh, top).opening(0.09, 0.75)
    points = grid.points().reshape(*grid.shape, 3)
    inside = np.linalg.norm(points - [0, HALF - 0.2, 0], axis=-1) < 0.2
    reaching = (np.abs(points[..., 0]) < 0.08) & (np.abs(points[..., 1] - (HALF - 0.2)) < 0.08) & (points[..., 2] > 0)
    away = np.linalg.norm(points - [0, -HALF, 0], axis=-1) < 0.2
    assert np.array_equal(apart(inside | reaching | away, grid, [mouth]), away)
    assert np.array_equal(apart(inside | away, grid, []), inside | away)
