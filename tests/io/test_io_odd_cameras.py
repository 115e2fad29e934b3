"""Cameras that look past the object, stand in one place, or contradict the others are named."""

import numpy as np
import pytest

from exmesh_graph.errors import DataError
from exmesh_graph.io.normalise import FILL, looking_away, some, sphere_from_masks
from tests.stage1.stage1_scenes import ball, photographs


def turned(poses, index, degrees):
    poses = poses.copy()
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    poses[index, :3, :3] = poses[index, :3, :3] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return poses


@pytest.mark.parametrize("degrees", [0, 15, 30, 41, 60, 120, 180])
def test_looking_away_is_no_point_of_the_sphere_in_the_picture(degrees):
    views = photographs(ball(), 6, 48)
    poses = turned(views.camera_to_world, 3, degrees)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20_000, 3))
    points *= FILL / np.linalg.norm(points, axis=1, keepdims=True)
    inverse = np.linalg.inv(poses[3])
    image = (points @ inverse[:3, :3].T + inverse[:3, 3]) @ views.intrinsics[3].T
    pixel = image[:, :2] / image[:, 2:]
    shown = (image[:, 2] > 0) & (pixel > 0).all(axis=1) & (pixel < 48).all(axis=1)
    assert looking_away(views.intrinsics, poses, 48, 48) == ([] if shown.any() else [3])


def test_a_mask_against_all_others_is_named():
    views = photographs(ball(), 8, 48)
    poses = turned(views.camera_to_world, 5, 40)
    sphere_from_masks(views.alpha, views.intrinsics, views.camera_to_world, names=views.names)
    with pytest.raises(DataError, match="no common part") as caught:
        sphere_from_masks(views.alpha, views.intrinsics, poses, names=views.names)
    assert caught.value.where == "against most others: v5"


def test_views_without_a_mask_do_not_move_the_sphere():
    views = photographs(ball(), 8, 48)
    centre, radius = sphere_from_masks(views.alpha, views.intrinsics, views.camera_to_world)
    alpha = views.alpha.copy()
    alpha[[1, 6]] = 1
    there, size = sphere_from_masks(alpha, views.intrinsics, views.camera_to_world)
    np.testing.assert_allclose(there, centre, atol=0.08)  # the hull has fewer sides
    assert abs(size - radius) < 0.08


def test_lists_of_names_stay_short():
    assert some(["a", "b"]) == "a, b"
    assert some([str(i) for i in range(12)]) == "0, 1, 2, 3, 4, 5, 6, 7 and 4 more"
