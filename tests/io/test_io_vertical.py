"""The vertical of a world found from pictures alone, whichever way the camera was held."""

import numpy as np
import pytest

from exmesh_graph.io.vertical import turntable_axis, upright_world
from tests.io.test_io_cameras import level_cameras, random_rotation


def held(poses, turns):
    """The same cameras, each turned about its axis by so many quarters."""
    turned = poses.copy()
    for pose, turn in zip(turned, turns, strict=True):
        for _ in range(turn):
            pose[:3, 0], pose[:3, 1] = pose[:3, 1].copy(), -pose[:3, 0].copy()
    return turned


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("turns", "said"),
    [([0] * 12, ""), ([0, 2] * 6, "some pictures are upside down"), ([2, 2, 0] * 4, ""), ([1] * 12, "on their side"),
     ([1, 3] * 6, "on their side")],
)  # fmt: skip
def test_up_is_found_however_the_camera_was_held(seed, turns, said):
    world = random_rotation(seed)
    rotation, note = upright_world(held(level_cameras(12, world), turns))
    up = rotation[:3, :3] @ world @ [0, 1, 0]
    expected = -1 if turns == [2, 2, 0] * 4 else 1  # most pictures say so
    assert up == pytest.approx([0, expected, 0], abs=1e-6)
    assert np.linalg.det(rotation[:3, :3]) == pytest.approx(1)
    assert said in note
    assert bool(said) == bool(note)
    assert turntable_axis(held(level_cameras(12, world), turns)) == pytest.approx(
        expected * (world @ [0, 1, 0]), abs=1e-6
    )


def test_cameras_of_one_place_give_the_mean_of_their_own_up_and_say_so():
    rotation, note = upright_world(np.repeat(np.diag([1.0, -1, -1, 1])[None], 4, axis=0))
    assert rotation[:3, :3] == pytest.approx(np.eye(3))
    assert "do not tell" in note


def test_cameras_that_stand_around_nothing_tell_no_axis():
    poses = np.repeat(np.eye(4)[None], 200, axis=0)
    poses[:, :3, :3] = [random_rotation(seed) for seed in range(200)]  # held anyhow
    assert turntable_axis(poses) is None
    assert turntable_axis(np.repeat(np.eye(4)[None], 3, axis=0)) is None
