"""The small scenes as fixtures."""

import numpy as np
import pytest
from io_scenes import ANGLE, CENTRE, RADIUS, SIZE, ring, sphere_picture, write_blender

from exmesh_graph.io.cameras import intrinsics_from_fov
from exmesh_graph.io.images import encode_rgba, write_image


@pytest.fixture
def blender_scene(tmp_path):
    write_blender(tmp_path, "train", ring(9))
    write_blender(tmp_path, "test", ring(3, offset=0.2))
    return tmp_path


@pytest.fixture
def middlebury_scene(tmp_path):
    (tmp_path / "image").mkdir()
    (tmp_path / "mask").mkdir()
    k = intrinsics_from_fov(ANGLE, SIZE, SIZE)
    poses = ring(10, up=(0, 1, 0))
    lines = [str(len(poses))]
    for i, pose in enumerate(poses):
        rgb, alpha, _ = sphere_picture(pose, k)
        write_image(tmp_path / "image" / f"v{i:02d}.png", encode_rgba(rgb, np.maximum(alpha, 1e-3))[..., :3])
        write_image(tmp_path / "mask" / f"v{i:02d}.png", alpha)
        world_to_camera = np.linalg.inv(pose)
        stored = k.copy()
        stored[:2, 2] -= 0.5
        numbers = [*stored.ravel(), *world_to_camera[:3, :3].ravel(), *world_to_camera[:3, 3]]
        lines.append(" ".join([f"v{i:02d}.png", *(repr(float(x)) for x in numbers)]))
    (tmp_path / "ball_par.txt").write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.fixture
def idr_scene(tmp_path):
    (tmp_path / "image").mkdir()
    k = intrinsics_from_fov(ANGLE, SIZE, SIZE)
    scale = np.diag([2 * RADIUS, 2 * RADIUS, 2 * RADIUS, 1])
    scale[:3, 3] = CENTRE
    arrays = {}
    for i, pose in enumerate(ring(10, up=(0, 1, 0))):
        rgb, _, _ = sphere_picture(pose, k)
        write_image(tmp_path / "image" / f"{i:06d}.png", encode_rgba(rgb, np.ones(rgb.shape[:2], np.float32))[..., :3])
        world = np.eye(4)
        stored = k.copy()
        stored[:2, 2] -= 0.5
        world[:3] = -2.5 * stored @ np.linalg.inv(pose)[:3]
        arrays[f"world_mat_{i}"], arrays[f"scale_mat_{i}"] = world, scale
    np.savez(tmp_path / "cameras_sphere.npz", **arrays)
    return tmp_path
