"""Camera conventions: OpenCV axes and pixel intrinsics inside; everything else is converted here.

Pixel centres lie at +0.5, so an image's left edge is x = 0 and halving its size halves every entry of K's first rows.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.settings import UpAxis

# Rows: the Y-up scene's x, y, z as combinations of the data set's axes. "z" is (x, y, z) -> (x, z, -y).
_SCENE_FROM_DATASET: dict[str, list[list[int]]] = {
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "x": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
}


def scene_from_dataset(up: UpAxis, camera_to_world: np.ndarray) -> np.ndarray:
    """float64 [4, 4] rotation that turns a world whose up is `up` into the Y-up world.

    "auto" takes the direction that is most nearly at right angles to the x axes of all cameras [N, 4, 4]: where the
    photographer held the camera level, that is the vertical. Raises DataError where the cameras do not tell.
    """
    rotation = np.eye(4)
    rotation[:3, :3] = _up_from_cameras(camera_to_world) if up == "auto" else _SCENE_FROM_DATASET[up]
    return rotation


def _up_from_cameras(camera_to_world: np.ndarray) -> np.ndarray:
    _, spread, axes = np.linalg.svd(camera_to_world[:, :3, 0], full_matrices=True)
    if len(spread) < 3 or spread[1] < 0.1 * spread[0] or spread[2] > 0.7 * spread[1]:
        raise DataError(
            "the cameras do not tell which way is up",
            expected="level cameras looking from several sides",
            fix="set the loader's `up` to an axis of the files' world: y, -y, z, -z, x or -x",
        )
    return rotation_to_y(axes[2] * np.sign(-camera_to_world[:, :3, 1].sum(0) @ axes[2]))


def rotation_to_y(up: np.ndarray) -> np.ndarray:
    """The [3, 3] rotation about up x Y that takes the unit vector `up` to Y (Rodrigues' formula)."""
    y = np.array([0.0, 1.0, 0.0])
    axis, cosine = np.cross(up, y), float(up @ y)
    if cosine < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


def opencv_from_blender(camera_to_world: np.ndarray) -> np.ndarray:
    """[..., 4, 4] with Blender / NeRF camera axes (y up, looks along -z) to OpenCV axes (y down, looks along +z)."""
    return camera_to_world @ np.diag([1.0, -1.0, -1.0, 1.0])


def camera_to_world_from_rt(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """float64 [4, 4] camera-to-world from x_cam = R X + t."""
    camera_to_world = np.eye(4)
    camera_to_world[:3, :3] = rotation.T
    camera_to_world[:3, 3] = -rotation.T @ translation
    return camera_to_world


def intrinsics_from_fov(angle_x: float, width: int, height: int) -> np.ndarray:
    """float64 [3, 3]: square pixels, principal point at the centre, f = w / (2 tan(angle_x / 2))."""
    focal = 0.5 * width / np.tan(0.5 * angle_x)
    return np.array([[focal, 0, 0.5 * width], [0, focal, 0.5 * height], [0, 0, 1.0]])


def reduced_size(size: tuple[int, int], factor: float) -> tuple[int, int]:
    """(width, height) of a picture of `size` reduced by any factor (`io.reduce.area_means`)."""
    return max(1, int(size[0] / factor + 1e-9)), max(1, int(size[1] / factor + 1e-9))


def scale_intrinsics(intrinsics: np.ndarray, factor: float) -> np.ndarray:
    """Intrinsics [..., 3, 3] of the same picture reduced by `factor` (pixel centres at +0.5)."""
    scaled = np.array(intrinsics, dtype=np.float64)
    scaled[..., :2, :] /= factor
    return scaled


def decompose_projection(projection: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split P [3, 4] = s K [R | t] into K [3, 3] (upper triangular, K_33 = 1, positive focal lengths), R and t.

    Works for P of any scale and sign; the world may differ from the camera's by a similarity, which ends up in the
    scale of P and is divided out: the same pixels result for all points in front of the camera.
    Raises DataError naming `where` for a P whose left 3 x 3 block is singular.
    """
    left = np.asarray(projection, dtype=np.float64)[:3, :3]
    if not np.isfinite(projection).all() or np.linalg.cond(left) > 1e12:
        raise _bad_camera("the projection matrix is singular or not finite", where)
    # RQ decomposition by QR of the reversed matrix: M = K R with K upper triangular, R orthogonal.
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ left).T)
    k, rotation = flip @ r.T @ flip, flip @ q.T
    signs = np.sign(np.diag(k))
    k, rotation = k * signs, signs[:, None] * rotation
    translation = np.linalg.solve(k, np.asarray(projection, dtype=np.float64)[:3, 3])
    if np.linalg.det(rotation) < 0:  # P was given with a negative scale
        rotation, translation = -rotation, -translation
    scale = k[2, 2]
    return k / scale, rotation, translation


def check_camera(intrinsics: np.ndarray, camera_to_world: np.ndarray, where: str) -> None:
    """DataError naming `where` unless K is invertible with positive focal lengths and the pose is rigid."""
    if not (np.isfinite(intrinsics).all() and np.isfinite(camera_to_world).all()):
        raise _bad_camera("the camera holds NaN or Inf", where)
    if intrinsics[0, 0] <= 0 or intrinsics[1, 1] <= 0 or abs(intrinsics[2, 2]) < 1e-12:
        raise _bad_camera(
            f"the intrinsics are singular (focal lengths {intrinsics[0, 0]:g}, {intrinsics[1, 1]:g})", where
        )
    rotation = camera_to_world[:3, :3]
    determinant = np.linalg.det(rotation)
    if abs(determinant) < 1e-6:
        raise _bad_camera(f"the camera matrix is singular (determinant {determinant:.3g})", where)
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > 1e-3 or determinant < 0 or np.abs(camera_to_world[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise _bad_camera(
            f"the camera matrix is not rigid (determinant {determinant:.4g}, R^T R differs from I by {error:.3g})",
            where,
        )


def _bad_camera(what: str, where: str) -> DataError:
    return DataError(
        what,
        where=where,
        expected="a 4 x 4 camera-to-world matrix of a rotation (determinant +1) and a translation, and K with f > 0",
        fix="export the cameras again without scale, shear or mirroring; leave out views that were not registered",
    )


def nearest_rotation(rotation: np.ndarray) -> np.ndarray:
    """The rotation closest to a [3, 3] matrix that passed `check_camera` (files carry few digits)."""
    u, _, vt = np.linalg.svd(rotation)
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
