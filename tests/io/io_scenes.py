"""Small scenes written to disk: a sphere seen by a ring of cameras, in each of the layouts."""

import json

import numpy as np

from exmesh_graph.io.cameras import intrinsics_from_fov
from exmesh_graph.io.envmaps import shift_columns
from exmesh_graph.io.images import encode_rgba, write_image

CENTRE, RADIUS, SIZE, ANGLE = np.array([0.5, -0.3, 0.2]), 0.4, 48, 0.5


def look_at(eye, target, up):
    """OpenCV camera-to-world."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
    return pose


def ring(count, up=(0, 0, 1), offset=0.0):
    """Cameras around CENTRE at several heights, the object a little off their axes."""
    up = np.array(up, float)
    a = np.roll(up, 1)
    b = np.cross(up, a)
    poses = []
    for i in range(count):
        angle = 2 * np.pi * i / count + offset
        height = (0.1, 0.7, -0.4)[i % 3]
        eye = CENTRE + 3 * (np.cos(angle) * a + np.sin(angle) * b + height * up)
        poses.append(look_at(eye, CENTRE + 0.1 * a, up))
    return np.stack(poses)


def sphere_picture(pose, k=None, size=SIZE, samples=4):
    """(rgb linear premultiplied, alpha, z-depth) of the sphere, coloured by position; alpha by supersampling."""
    k = intrinsics_from_fov(ANGLE, size, size) if k is None else k
    steps = (np.arange(size * samples) + 0.5) / samples
    x, y = np.meshgrid(steps, steps)
    d = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(k).T @ pose[:3, :3].T
    to = pose[:3, 3] - CENTRE
    a, b, c = (d * d).sum(-1), 2 * (d @ to), to @ to - RADIUS**2
    inside = b * b - 4 * a * c
    hit = inside > 0
    depth = np.where(hit, (-b - np.sqrt(np.maximum(inside, 0))) / (2 * a), 0)
    colour = np.clip(0.5 + 0.4 * (pose[:3, 3] + depth[..., None] * d - CENTRE) / RADIUS, 0, 1) * hit[..., None]
    blocks = (size, samples, size, samples)
    rgb = colour.reshape(*blocks, 3).mean((1, 3))
    return rgb.astype(np.float32), hit.reshape(blocks).mean((1, 3)).astype(np.float32), depth


def write_blender(folder, split, poses, start=0, ending="_rgba.png", size=SIZE):
    (folder / split).mkdir(parents=True, exist_ok=True)
    frames = []
    for i, pose in enumerate(poses, start):
        rgb, alpha, _ = sphere_picture(pose, size=size)
        if ending.endswith("exr"):
            write_image(folder / split / f"{i:03d}{ending}", np.dstack([rgb, alpha]), "float")
        else:
            write_image(folder / split / f"{i:03d}{ending}", encode_rgba(rgb, alpha))
        frames.append({"file_path": f"{split}/{i:03d}", "transform_matrix": blender_from_opencv(pose).tolist()})
    content = {"camera_angle_x": ANGLE, "w": size, "h": size, "frames": frames}
    (folder / f"transforms_{split}.json").write_text(json.dumps(content))


def edit_json(file, change):
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def blender_from_opencv(camera_to_world):
    """The inverse of `io.cameras.opencv_from_blender`; the same flip."""
    return camera_to_world @ np.diag([1.0, -1.0, -1.0, 1.0])


def blender_from_canonical(radiance: np.ndarray) -> np.ndarray:
    """The inverse of `io.envmaps.canonical_from_blender` (exact where W is a multiple of 4)."""
    return shift_columns(radiance, -radiance.shape[1] / 4)


def blender_directions(height: int, width: int) -> np.ndarray:
    """float64 [H, W, 3] unit directions, in the z-up world, of a Blender map's texel centres."""
    phi = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    theta = np.pi * (np.arange(height) + 0.5) / height
    phi, theta = np.meshgrid(phi, theta)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def of_placed(placed):
    """(scene, sparse points in its world, motion) of photographs with cameras."""
    scene = placed.scene()
    return scene, placed.points(scene.frame), placed.motion
