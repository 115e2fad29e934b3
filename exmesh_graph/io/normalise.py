"""The recorded similarity that puts the object into the unit sphere, found from masks, cameras, or given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.close_ups import close_ups, cuts_off
from exmesh_graph.geometry.hull import Grid, SilhouetteField
from exmesh_graph.types import Frame

FILL = 0.95  # radius of the object's bounding sphere after normalisation: room for a loose first surface
_GRID = 40


def make_frame(centre: np.ndarray, radius: float, rotation: np.ndarray, metres_per_unit: float = 0.0) -> Frame:
    """Frame that maps the sphere (`centre`, `radius`), in the data set's own axes and units, to radius `FILL`.

    `rotation` [4, 4] is `cameras.scene_from_dataset`'s. scene = scene_from_normalised @ normalised and
    dataset = dataset_from_scene @ scene.
    """
    similarity = np.eye(4)
    similarity[:3, :3] *= radius / FILL
    similarity[:3, 3] = rotation[:3, :3] @ centre
    return Frame(similarity, rotation.T.copy(), metres_per_unit)


def sphere_of(frame: Frame) -> tuple[np.ndarray, float]:
    """(centre [3], radius) in the data set's axes and units that `make_frame` makes the frame of."""
    return frame.dataset_from_scene[:3, :3] @ frame.scene_from_normalised[:3, 3], FILL * frame_scale(frame)


def frame_scale(frame: Frame) -> float:
    """Scene units in one normalised unit."""
    return float(np.cbrt(np.linalg.det(frame.scene_from_normalised[:3, :3])))


def points_to_normalised(points: np.ndarray, frame: Frame) -> np.ndarray:
    """float64 [P, 3] dataset points to the normalised Y-up world."""
    matrix = np.linalg.inv(frame.dataset_from_scene @ frame.scene_from_normalised)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def cameras_to_normalised(camera_to_world: np.ndarray, frame: Frame) -> np.ndarray:
    """float64 [N, 4, 4] rigid poses in the data set's world to rigid poses in the normalised world."""
    out = np.array(camera_to_world, dtype=np.float64)
    out[:, :3, :3] = frame.dataset_from_scene[:3, :3].T @ out[:, :3, :3]
    out[:, :3, 3] = points_to_normalised(out[:, :3, 3], frame)
    return out


def cameras_from_normalised(camera_to_world: np.ndarray, frame: Frame) -> np.ndarray:
    """float64 [N, 4, 4] rigid poses in the data set's world of rigid poses in the normalised world."""
    out = np.array(camera_to_world, dtype=np.float64)
    matrix = frame.dataset_from_scene @ frame.scene_from_normalised
    out[:, :3, :3] = frame.dataset_from_scene[:3, :3] @ out[:, :3, :3]
    out[:, :3, 3] = out[:, :3, 3] @ matrix[:3, :3].T + matrix[:3, 3]
    return out


def nearest_point(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Point with the least sum of squared distances to N lines (origins, unit directions [N, 3]).

    Raises DataError for parallel lines (one view, or a translating camera), which meet nowhere.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    normal = across.sum(0)
    if np.linalg.cond(normal) > 1e8:
        raise DataError(
            "the viewing directions are all parallel, so the object cannot be located",
            fix="add views from other sides, or give the object's box in the loader's `box`",
        )
    return np.linalg.solve(normal, (across @ origins[:, :, None]).sum(0)[:, 0])


def sphere_from_cameras(intrinsics: np.ndarray, camera_to_world: np.ndarray, width: int, height: int) -> tuple[
    np.ndarray, float
]:  # fmt: skip
    """Without masks: centre = the point nearest to all optical axes, radius = what every view shows whole."""
    origins, axes = camera_to_world[:, :3, 3], camera_to_world[:, :3, 2]
    centre = nearest_point(origins, axes)
    distance = np.einsum("ni,ni->n", centre - origins, axes)
    half = np.minimum(width / intrinsics[:, 0, 0], height / intrinsics[:, 1, 1]) / 2
    radius = float((np.abs(distance) * half / np.hypot(1, half)).min())
    return centre, radius


def sphere_from_masks(
    alpha: np.ndarray,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    *,
    wrong_masks: int = 0,
    names: Sequence[str] = (),
) -> tuple[np.ndarray, float]:
    """Bounding sphere (centre [3], radius) of the masks' visual hull, in the world of the cameras.

    The rays through the middles of the masks give a first centre and the masks' extent a first radius, neither of
    which asks the optical axes to meet in the object; the hull on a coarse grid, refined once, then gives the sphere.
    Views without a mask (alpha 1 all over) say nothing. Raises DataError where the masks have no common part.
    """
    masked = (alpha < 1).any(axis=(1, 2))
    centre, radius = centre_of_masks(alpha[masked], intrinsics[masked], camera_to_world[masked])
    field = SilhouetteField.from_masks(alpha, intrinsics, np.linalg.inv(camera_to_world), wrong_masks=wrong_masks)
    low, high = centre - 1.3 * radius, centre + 1.3 * radius
    inside = np.zeros((0, 3))
    for _ in range(2):
        grid = Grid.over(low, high, _GRID)
        points = grid.points().astype(np.float64)
        inside = points[field(points, -2.5 * grid.step) > -0.5 * grid.step]
        if len(inside) == 0:
            against = field.against(points) if names else ()
            raise DataError(
                "the masks of the views have no common part",
                where=f"against most others: {some([names[i] for i in against])}" if len(against) else "",
                expected="cameras and masks of one object",
                fix="check the cameras' convention (axes, up, intrinsics for this image size) and the masks",
            )
        low, high = inside.min(0) - 1.5 * grid.step, inside.max(0) + 1.5 * grid.step
    return bounding_sphere(inside)


def looking_away(intrinsics: np.ndarray, camera_to_world: np.ndarray, width: int, height: int) -> list[int]:
    """Indices of normalised cameras in whose pictures no part of the object's sphere (radius `FILL`) can appear."""
    centre = -np.einsum("nji,nj->ni", camera_to_world[:, :3, :3], camera_to_world[:, :3, 3])
    away = []
    for i, (k, (x, y, z)) in enumerate(zip(intrinsics, centre, strict=True)):
        # the four side planes of the picture's pyramid, and the plane of the camera
        planes = [
            (k[0, 0] * x + k[0, 2] * z, np.hypot(k[0, 0], k[0, 2])),
            ((width - k[0, 2]) * z - k[0, 0] * x, np.hypot(k[0, 0], width - k[0, 2])),
            (k[1, 1] * y + k[1, 2] * z, np.hypot(k[1, 1], k[1, 2])),
            ((height - k[1, 2]) * z - k[1, 1] * y, np.hypot(k[1, 1], height - k[1, 2])),
            (z, 1.0),
        ]
        if any(value < -FILL * length for value, length in planes):
            away.append(i)
    return away


def some(names: Sequence[str]) -> str:
    """Names for a message: the first eight."""
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def bounding_sphere(points: np.ndarray, steps: int = 200) -> tuple[np.ndarray, float]:
    """A sphere around [P, 3] points, within about 1 % of the smallest (Badoiu-Clarkson: step to the farthest)."""
    centre = (points.min(0) + points.max(0)) / 2
    best, radius = centre, np.inf
    for step in range(steps):
        offsets = points - centre
        squared = np.einsum("pi,pi->p", offsets, offsets)
        farthest = squared.argmax()
        if squared[farthest] < radius**2:
            best, radius = centre, float(np.sqrt(squared[farthest]))
        centre = centre + offsets[farthest] / (step + 10)
    return best, radius


def sphere_from_box(low: Sequence[float], high: Sequence[float]) -> tuple[np.ndarray, float]:
    """Sphere around a given box in the data set's units. DataError where the box has no volume."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    if not (a < b).all():
        raise DataError(f"the box {list(low)} .. {list(high)} is empty", expected="[[xmin, ymin, zmin], [xmax, ...]]")
    return (a + b) / 2, float(np.linalg.norm(b - a) / 2)


def centre_of_masks(alpha: np.ndarray, intrinsics: np.ndarray, camera_to_world: np.ndarray) -> tuple[np.ndarray, float]:
    """(centre [3], radius): where rays through the middles of masks [N, H, W] meet, and how far these reach there.

    Close-ups (`geometry.close_ups`) show no middle and are not asked. DataError for an empty mask and for parallel
    rays.
    """
    whole = ~close_ups(np.array([cuts_off(mask >= 0.5) for mask in alpha], bool))
    alpha, intrinsics, camera_to_world = alpha[whole], intrinsics[whole], camera_to_world[whole]
    middles, extents = [], []
    for mask in alpha:
        rows, columns = np.nonzero(mask >= 0.5)
        if len(rows) == 0:
            raise DataError("a mask is empty: no pixel has alpha >= 0.5", fix="leave this view out, or mend its mask")
        low = np.array([columns.min(), rows.min()])
        high = np.array([columns.max() + 1, rows.max() + 1])
        middles.append((low + high) / 2)
        extents.append(np.linalg.norm(high - low) / 2)
    pixels = np.concatenate([np.array(middles), np.ones((len(alpha), 1))], axis=1)
    rays = np.einsum("nij,njk,nk->ni", camera_to_world[:, :3, :3], np.linalg.inv(intrinsics), pixels)
    origins = camera_to_world[:, :3, 3]
    centre = nearest_point(origins, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    depth = np.einsum("ni,ni->n", centre - origins, camera_to_world[:, :3, 2])
    focal = np.sqrt(intrinsics[:, 0, 0] * intrinsics[:, 1, 1])
    return centre, float((np.array(extents) * np.abs(depth) / focal).max())
