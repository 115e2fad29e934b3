"""The plane under an object: found, told from a base of its own, not made up."""

import numpy as np
import pytest

from exmesh_graph.masks.plane import Plane, find_plane

CAMERAS = np.array([[3.0, 1, 0], [-2, 2, 1], [0, 1.5, -3], [1, 0.8, 3]])


def points(table, base=0.3, noise=0.004, seed=0):
    """A box of half-width `base` on a square of half-width `table` at height 0: points, normals, areas."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform(-table, table, (3000, 2))
    flat = flat[np.abs(flat).max(axis=1) > base] if table > base else rng.uniform(-base, base, (3000, 2))
    ground = np.column_stack([flat[:, 0], rng.normal(0, noise, len(flat)), flat[:, 1]])
    turn, height = rng.uniform(-1, 1, 2000), rng.uniform(0, 0.8, 2000)
    side = rng.integers(0, 4, 2000)
    outward = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]], float)[side]
    across = outward[:, [2, 1, 0]] * [1, 0, 1]
    walls = base * outward + base * turn[:, None] * across + height[:, None] * [0, 1, 0]
    normals = np.concatenate([np.tile([0.0, 1, 0], (len(ground), 1)), outward])
    return np.concatenate([ground, walls]), normals, np.ones(len(ground) + len(walls))


def turned(where, seed):
    from scipy.spatial.transform import Rotation

    r = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    return [part @ r.T for part in where], r @ [0, 1, 0]


@pytest.mark.parametrize("seed", range(4))
def test_the_table_is_found_however_the_world_is_turned(seed):
    where, normals, areas = points(0.9)
    (where, normals, cameras), up = turned([where, normals, CAMERAS], seed)
    plane = find_plane(where + up * 0.25, normals, areas, cameras + up * 0.25, 0.02)
    assert plane is not None
    assert plane.normal @ up > 0.999
    assert plane.offset == pytest.approx(0.25, abs=0.003)
    assert plane.is_table
    assert plane.share == pytest.approx((np.arange(len(areas)) < len(areas) - 2000).mean(), abs=0.05)
    assert plane.height(where + up * 0.35).max() == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("seed", range(4))
def test_rays_meet_the_plane_where_they_go_down_to_it(seed):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    plane = Plane(normal, 0.4, 1.0)
    (turn,), _ = turned([np.eye(3)], seed)
    to_camera = np.eye(4)
    to_camera[:3, :3] = turn
    eye, rays = 2.4 * normal + rng.normal(size=3), rng.normal(size=(50, 3))
    eye += max(0, 0.5 - plane.height(eye)) * normal  # above it
    to_camera[:3, 3] = -turn @ eye
    far = plane.met(rays, to_camera)
    down = rays @ normal < 0
    assert down.any()
    assert not down.all()
    assert np.isinf(far[~down]).all()
    assert np.abs(plane.height(eye + far[down, None] * rays[down])).max() < 1e-9
    below = to_camera.copy()
    below[:3, 3] = -turn @ (eye - 2 * plane.height(eye) * normal)
    assert np.isinf(plane.met(rays, below)).all()


def test_a_base_of_the_object_is_no_table():
    plane = find_plane(*points(0.2), CAMERAS, 0.02)
    assert plane is not None
    assert plane.under > 0.9
    assert not plane.is_table


@pytest.mark.parametrize("share", [0.02, 0.06])
def test_specks_at_the_far_rim_of_a_table_do_not_make_it_a_base(share):
    """As stereo leaves them where many pictures look along the table: their outline holds all of it."""
    where, normals, _ = points(0.9)
    rng = np.random.default_rng(1)
    count = round(share * 2000)
    turn = rng.uniform(0, 2 * np.pi, count)
    specks = np.column_stack([1.2 * np.sin(turn), rng.uniform(0.1, 0.3, count), 1.2 * np.cos(turn)])
    where, normals = np.concatenate([where, specks]), np.concatenate([normals, specks])
    plane = find_plane(where, normals, np.ones(len(where)), CAMERAS, 0.02)
    assert plane is not None
    assert plane.is_table
    assert plane.under < 0.2


def test_two_objects_on_a_table_are_both_what_stands_on_it():
    where, normals, _ = points(0.9)
    half = np.concatenate([where[:-2000], where[-2000:] * 0.5 + [0.5, 0, 0], where[-2000:] * 0.5 - [0.5, 0, 0]])
    plane = find_plane(half, np.concatenate([normals, normals[-2000:]]), np.ones(len(half)), CAMERAS, 0.02)
    assert plane is not None
    assert 0.05 < plane.under < 0.3  # the outline of both, which is 0.39 of the table's 3.24, most of it seen


def test_a_plane_that_cameras_look_up_at_is_none():
    where, normals, areas = points(0.9)
    below = CAMERAS * [1, -1, 1]
    found = find_plane(where, normals, areas, below, 0.02)
    assert found is None or abs(found.normal[1]) < 0.1


def test_no_plane_where_nothing_stands_on_it_or_there_are_no_points():
    where, normals, areas = points(0.9)
    flat = np.abs(where[:, 1]) < 0.02
    assert find_plane(where[flat], normals[flat], areas[flat], CAMERAS, 0.02) is None
    assert find_plane(where[:2], normals[:2], areas[:2], CAMERAS, 0.02) is None
    ball = np.random.default_rng(0).normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert find_plane(ball, ball, np.ones(4000), CAMERAS, 0.005) is None
