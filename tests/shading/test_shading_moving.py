"""Light that moves with the camera: the frames of views, the turned map."""

import numpy as np
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from exmesh_graph.shading import envmap
from exmesh_graph.shading.moving import light_turns, turned
from exmesh_graph.testing import look_at

UNIT = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.3)
ANGLES = st.lists(st.floats(-np.pi, np.pi), min_size=1, max_size=5)


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    return pose


@given(axis=UNIT, start=UNIT, angles=ANGLES)
def test_what_turns_with_the_camera_stands_still_in_the_lights_frame(axis, start, angles):
    """A lamp that goes round with the camera is in one direction of the frame, whatever the angle."""
    assume(np.linalg.norm(start[[0, 2]]) > 0.1)  # look_at knows no camera straight above
    axis = axis / np.linalg.norm(axis)
    first = look_at(2 * start)
    poses = np.stack([_about(axis, angle) @ first for angle in [0.0, *angles]])
    lamp = np.array([0.3, -0.5, 0.8])
    for kind in (axis, np.zeros(3)):
        turns = light_turns(kind, poses)
        np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(turns), 1, atol=1e-9)
        seen = np.stack(
            [turn @ (pose[:3, :3] @ first[:3, :3].T @ lamp) for turn, pose in zip(turns, poses, strict=True)]
        )
        np.testing.assert_allclose(seen, np.broadcast_to(seen[0], seen.shape), atol=1e-7)


def test_the_frames_are_as_the_module_says():
    pose = look_at(np.array([0.0, 1.0, 2.0]))
    by_camera, by_table = light_turns(np.zeros(3), pose[None])[0], light_turns(np.array([0, 2.0, 0]), pose[None])[0]
    towards = np.array([0, 1.0, 2.0]) / np.sqrt(5)
    np.testing.assert_allclose(by_camera @ towards, [0, 0, 1], atol=1e-12)  # from behind the photographer
    np.testing.assert_allclose(by_table, np.eye(3), atol=1e-12)  # +Y up, the camera at +Z
    assert light_turns(None, pose[None]) is None


def test_a_camera_straight_above_has_the_azimuth_of_its_upper_edge():
    """Beside it stands one that is a little off: their frames are nearly one."""
    above, beside = look_at(np.array([0.0, 3.0, 1e-6])), look_at(np.array([0.0, 3.0, 0.9]))
    turns = light_turns(np.array([0, 1.0, 0]), np.stack([above, beside]))
    np.testing.assert_allclose(turns[0], turns[1], atol=1e-4)


@given(axis=UNIT, angle=st.floats(-np.pi, np.pi), towards=UNIT)
def test_the_turned_map_is_read_as_the_map_in_its_own_frame(axis, angle, towards):
    sky = torch.from_numpy(1 + envmap.texel_directions(48, 96) * 0.5)
    turn = _about(axis, angle)[:3, :3]
    towards = towards / np.linalg.norm(towards)
    found = envmap.lookup(turned(sky, turn), torch.from_numpy(towards))
    torch.testing.assert_close(
        found, envmap.lookup(sky, torch.from_numpy(turn @ towards)), atol=0.04, rtol=0
    )  # at the poles


def test_turning_keeps_the_light_and_by_nothing_the_bytes():
    sky = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    assert turned(sky, None) is sky
    torch.testing.assert_close(turned(sky, np.eye(3)), sky, atol=1e-5, rtol=0)
    other = turned(sky, _about(np.array([0.3, 0.2, 0.9]), 1.1)[:3, :3])
    torch.testing.assert_close(envmap.mean_radiance(other), envmap.mean_radiance(sky), rtol=0.02, atol=0)


def test_the_gradient_of_a_turned_map():
    sky = torch.rand(4, 8, 3, dtype=torch.float64, requires_grad=True, generator=torch.Generator().manual_seed(0))
    turn = _about(np.array([0.3, -0.8, 0.4]), 0.9)[:3, :3]
    assert torch.autograd.gradcheck(lambda e: turned(e, turn), (sky,))
