"""Camera conventions: axes, intrinsics, projection matrices, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from io_scenes import blender_from_opencv
from scipy.spatial.transform import Rotation

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import (
    camera_to_world_from_rt,
    check_camera,
    decompose_projection,
    intrinsics_from_fov,
    opencv_from_blender,
    scale_intrinsics,
    scene_from_dataset,
)
from tests.io.projecting import project


def random_rotation(seed):
    return Rotation.random(random_state=seed).as_matrix()


def test_blender_camera_looks_along_minus_z_with_y_up():
    pose = opencv_from_blender(np.eye(4))
    k = intrinsics_from_fov(np.pi / 2, 100, 60)
    # A point to the right of and above the optical axis lands right of and above the middle: smaller row.
    pixel, depth = project(np.array([[0.2, 0.1, -1.0]]), k, np.linalg.inv(pose))
    assert pixel[0] == pytest.approx([50 + 50 * 0.2, 30 - 50 * 0.1])
    assert depth[0] == pytest.approx(1)
    assert np.array_equal(blender_from_opencv(pose), np.eye(4))


def test_pixel_rays_of_the_synthetic_scenes_formula():
    """Column i, row j of the data's formula: d = ((i+.5-w/2)/f, -(j+.5-h/2)/f, -1) in Blender axes."""
    w, h, angle = 256, 200, 0.69
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = random_rotation(3), [1, 2, 3]
    f = 0.5 * w / np.tan(0.5 * angle)
    i, j = 17, 150
    direction = pose[:3, :3] @ [(i + 0.5 - w / 2) / f, -(j + 0.5 - h / 2) / f, -1]
    point = pose[:3, 3] + 2.5 * direction
    pixel, depth = project(point[None], intrinsics_from_fov(angle, w, h), np.linalg.inv(opencv_from_blender(pose)))
    assert pixel[0] == pytest.approx([i + 0.5, j + 0.5])
    assert depth[0] == pytest.approx(2.5)


@pytest.mark.parametrize("up", ["y", "-y", "z", "-z", "x", "-x"])
def test_up_axis_becomes_y_by_a_rotation(up):
    rotation = scene_from_dataset(up, np.eye(4)[None])[:3, :3]
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1 if up[0] == "-" else 1
    assert (rotation @ axis).tolist() == [0, 1, 0]
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert np.allclose(rotation @ rotation.T, np.eye(3))


def test_z_up_is_the_documented_map():
    assert (scene_from_dataset("z", np.eye(4)[None])[:3, :3] @ [1, 2, 3]).tolist() == [1, 3, -2]


def level_cameras(count, world):
    """Level cameras on a circle at two heights in a Y-up world that is then turned by `world`."""
    poses = []
    for i in range(count):
        angle, height = 2 * np.pi * i / count, 0.3 + 0.5 * (i % 3)
        eye = np.array([np.cos(angle), height, np.sin(angle)])
        z = -eye / np.linalg.norm(eye)
        x = np.cross(z, [0, 1, 0])
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = world @ np.stack([x, np.cross(z, x), z], axis=1)
        poses.append(pose)
    return np.stack(poses)


@pytest.mark.parametrize("seed", range(5))
def test_up_is_found_from_level_cameras(seed):
    world = random_rotation(seed)
    rotation = scene_from_dataset("auto", level_cameras(12, world))[:3, :3]
    assert rotation @ world @ [0, 1, 0] == pytest.approx([0, 1, 0], abs=1e-9)
    assert np.allclose(rotation @ rotation.T, np.eye(3))


def test_up_is_not_guessed_from_cameras_that_do_not_tell():
    with pytest.raises(DataError, match="which way is up"):
        scene_from_dataset("auto", np.repeat(np.eye(4)[None], 4, axis=0))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    focal=st.floats(50, 5000),
    aspect=st.floats(0.5, 2),
    skew=st.floats(-20, 20),
    factor=st.sampled_from([1.0, -1.0, 1e-3, -250.0]),
)
def test_decompose_projection_recovers_the_camera(seed, focal, aspect, skew, factor):
    rng = np.random.default_rng(seed)
    k = np.array([[focal, skew, rng.uniform(0, 500)], [0, focal * aspect, rng.uniform(0, 500)], [0, 0, 1]])
    rotation, translation = random_rotation(seed), rng.normal(size=3) * 10
    p = factor * k @ np.concatenate([rotation, translation[:, None]], axis=1)
    k2, r2, t2 = decompose_projection(p, "view")
    assert np.allclose(k2, k, rtol=1e-6, atol=1e-6 * focal)
    assert np.allclose(r2, rotation, atol=1e-7)
    assert np.allclose(t2, translation, atol=1e-6)
    assert np.linalg.det(r2) == pytest.approx(1)


def test_rt_and_scaled_intrinsics():
    rotation, translation = random_rotation(0), np.array([1.0, 2, 3])
    x = np.array([0.3, -0.2, 0.7])
    pose = camera_to_world_from_rt(rotation, translation)
    assert np.allclose(np.linalg.inv(pose) @ [*x, 1], [*(rotation @ x + translation), 1])
    k = np.array([[100.0, 2, 50], [0, 90, 40], [0, 0, 1]])
    assert scale_intrinsics(k, 2).tolist() == [[50, 1, 25], [0, 45, 20], [0, 0, 1]]


BAD = {
    "singular": (np.eye(3), np.diag([1.0, 1, 0, 1]), "singular"),
    "sheared": (np.eye(3), np.array([[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), "not rigid"),
    "scaled": (np.eye(3), np.diag([2.0, 2, 2, 1]), "not rigid"),
    "mirrored": (np.eye(3), np.diag([1.0, 1, -1, 1]), "not rigid"),
    "nan": (np.eye(3), np.full((4, 4), np.nan), "NaN"),
    "no focal length": (np.diag([0.0, 1, 1]), np.eye(4), "intrinsics are singular"),
    "negative focal length": (np.diag([100.0, -100, 1]), np.eye(4), "intrinsics are singular"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_cameras_are_named(name):
    k, pose, what = BAD[name]
    with pytest.raises(DataError, match=f"view 7: .*{what}"):
        check_camera(k, pose, "view 7")


def test_singular_projection_is_named():
    with pytest.raises(DataError, match=r"view 3: .*singular"):
        decompose_projection(np.zeros((3, 4)), "view 3")
