"""The hull above a plane: by kernels and in numpy, and from a flat mesh."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from exmesh_graph.geometry import footing as footing_of
from exmesh_graph.geometry.footing import base_row, footing
from exmesh_graph.geometry.grounded import Grounded
from exmesh_graph.geometry.hull import SilhouetteField, goes_on, visual_hull
from exmesh_graph.masks.plane import Plane
from exmesh_graph.types import Mesh


def ball_from_above() -> SilhouetteField:
    """A ball of radius 0.4 as six cameras see it that look down on it: its hull has a point below."""
    size, focal = 64, 80.0
    poses = []
    for angle in np.linspace(0, 2 * np.pi, 6, endpoint=False):
        back = np.array([np.cos(angle), 1.2, np.sin(angle)]) / np.sqrt(2.44)
        right = np.cross([0.0, 1, 0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.column_stack([right, -np.cross(back, right), -back, 3 * back])
        poses.append(pose)
    k = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    x, y = np.meshgrid(np.arange(size) + 0.5 - size / 2, np.arange(size) + 0.5 - size / 2)
    seen = np.hypot(x, y) < focal * 0.4 / np.sqrt(9 - 0.16)
    masks = np.repeat(seen[None].astype(np.float32), 6, axis=0)
    return SilhouetteField.from_masks(masks, np.stack([k] * 6), np.linalg.inv(np.stack(poses)))


def test_what_cameras_from_above_leave_open_ends_at_the_plane():
    field = ball_from_above()
    plane = Plane(np.array([0.0, 1, 0]), -0.4, 1.0)
    free, _ = visual_hull(field, resolution=48)
    assert free[:, 1].min() < -0.5
    for cut in (
        Grounded.above(field, plane.normal, plane.offset),
        Grounded.on(field, Mesh(*plane.square(free))),
    ):
        vertices, _ = visual_hull(cut, resolution=48)
        assert vertices[:, 1].min() == pytest.approx(-0.4, abs=0.01)
        assert vertices[:, 1].max() == pytest.approx(free[:, 1].max(), abs=0.02)


def test_a_hull_is_looked_for_as_far_as_its_reach():
    field = ball_from_above()
    whole = visual_hull(field, resolution=48)[0]
    near = replace(field, reach=0.3)
    for cut in (near, Grounded.above(near, np.array([0.0, 1, 0]), -0.4)):
        assert visual_hull(cut, resolution=48)[0].max() < 0.35 < whole.max()
        assert goes_on(cut)
    assert not goes_on(field)
    assert goes_on(replace(field, reach=0.62))  # its point below alone
    assert not goes_on(Grounded.above(replace(field, reach=0.62), np.array([0.0, 1, 0]), -0.4))


def test_kernels_give_what_numpy_gives():
    field = ball_from_above()
    normal = np.array([0.3, 0.9, -0.2]) / np.linalg.norm([0.3, 0.9, -0.2])
    cut = Grounded.above(field, normal, -0.1)
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (500, 3))
    np.testing.assert_allclose(cut(points), cut.plain(points), atol=1e-4)
    np.testing.assert_allclose(cut(points), np.minimum(field(points), points @ normal + 0.1), atol=1e-6)


def test_a_square_lies_in_its_plane_below_the_points_and_faces_up():
    normal = np.array([0.1, 0.9, 0.4]) / np.linalg.norm([0.1, 0.9, 0.4])
    points = np.random.default_rng(1).normal(0, 0.3, (100, 3))
    vertices, faces = Plane(normal, -0.7, 1.0).square(points)
    np.testing.assert_allclose(vertices @ normal, -0.7, atol=1e-6)
    a, b, c = vertices[faces].swapaxes(0, 1)
    across = np.cross(b - a, c - a)
    np.testing.assert_allclose(across / np.linalg.norm(across, axis=1, keepdims=True), [normal] * 2, atol=1e-5)
    flat = points - np.outer(points @ normal + 0.7, normal)
    assert np.linalg.norm(flat - vertices.mean(0), axis=1).max() < np.linalg.norm(vertices[0] - vertices.mean(0))


def seen_from(solid: Callable[[np.ndarray], np.ndarray], elevations: Sequence[float]) -> SilhouetteField:
    """The masks of a solid, True inside for points [..., 3], from cameras that go around it at these elevations."""
    size, focal, far = 96, 156.0, 3.0
    poses, masks = [], []
    x, y = np.meshgrid((np.arange(size) + 0.5 - size / 2) / focal, (np.arange(size) + 0.5 - size / 2) / focal)
    steps = np.linspace(far - 0.9, far + 0.9, 120)[:, None, None, None]
    for number, elevation in enumerate(elevations):
        up, around = np.radians([elevation, 137.5 * number])
        back = np.array([np.cos(up) * np.cos(around), np.sin(up), np.cos(up) * np.sin(around)])
        right = np.cross([0.0, 1, 0], back)
        right /= np.linalg.norm(right)
        turn = np.column_stack([right, -np.cross(back, right), -back])
        pose = np.eye(4)
        pose[:3] = np.c_[turn, far * back]
        masks.append(solid((steps * np.stack([x, y, np.ones_like(x)], -1)) @ turn.T + far * back).any(0))
        poses.append(pose)
    k = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    return SilhouetteField.from_masks(
        np.asarray(masks, np.float32), np.stack([k] * len(poses)), np.linalg.inv(np.stack(poses))
    )


def board(points: np.ndarray) -> np.ndarray:
    """A board half a unit wide with a post on it; it lies at y = -0.1."""
    plate = (np.abs(points) < [0.5, 0.05, 0.4]) | (np.abs(points - [0, -0.05, 0]) < [0.5, 0.05, 0.4])
    post = np.abs(points - [0.2, 0.25, 0.1]) < [0.04, 0.25, 0.04]
    return plate.all(-1) | post.all(-1)


@pytest.mark.thorough
def test_a_board_seen_from_above_ends_where_outlines_do():
    field = seen_from(board, np.linspace(14, 70, 15))
    points = visual_hull(field, resolution=96)[0]
    assert points[:, 1].min() < -0.25  # a pyramid under it
    base = footing(field)
    assert base is not None
    assert base.height == pytest.approx(-0.1, abs=0.03)
    assert base.height < -0.09  # nothing that is shown is cut
    assert base.depth == pytest.approx(base.height - points[:, 1].min(), abs=0.02)
    assert base_row(base)["value"] == "flat"
    cut = visual_hull(Grounded.above(field, np.array([0.0, 1, 0]), base.height), resolution=96)[0]
    assert cut[:, 1].min() == pytest.approx(base.height, abs=0.02)
    assert cut[:, 1].max() == pytest.approx(points[:, 1].max(), abs=0.02)


@pytest.mark.thorough
def test_a_base_that_is_seen_from_below_is_left():
    assert footing(seen_from(board, np.linspace(-25, 60, 15))) is None


@pytest.mark.thorough
def test_a_leg_below_the_rest_is_kept():
    def table(points: np.ndarray) -> np.ndarray:
        leg = np.abs(points - [0, -0.3, 0]) < [0.05, 0.3, 0.05]
        return board(points) | leg.all(-1)

    base = footing(seen_from(table, np.linspace(14, 70, 15)))
    assert base is not None
    assert base.height == pytest.approx(-0.6, abs=0.02)


def test_points_beside_and_behind_a_camera_take_no_room():
    points = np.random.default_rng(2).uniform(-1, 1, (20_000, 3))
    points[:, 2] = np.linspace(-1, 1, len(points))  # some all but in the camera's plane
    k = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])
    tops = footing_of._tops(points, k, np.eye(4), 0.05)
    assert len(tops) < 60_000
    assert np.isfinite(tops).all()
    assert np.isinf(footing_of._tops(points - [0, 0, 2], k, np.eye(4), 0.05)).all()
