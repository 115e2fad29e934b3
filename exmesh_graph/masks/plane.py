"""The plane that an object stands on, found among the points of a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.spatial import ConvexHull, QhullError

_TRIALS = 500
_SAMPLES = 8000
_FACING = np.cos(np.radians(30))
_CAMERAS = 0.95
_LEAST = 0.03
_BASE = 0.8
_ABOVE = 3.0
_PART = 0.1
"""Of what is above the plane: smaller groups are specks that stereo leaves at a table's far rim."""


@dataclass(frozen=True)
class Plane:
    """Points x with normal . x = offset; the cameras are on the side that the normal points to.

    share  of the surface's area that lies in it
    under  share of its own area below the object, less specks: near 1 it is the object's own base
    """

    normal: np.ndarray
    offset: float
    share: float
    under: float = 1.0

    def height(self, points: np.ndarray) -> np.ndarray:
        """Signed distance [P] of points [P, 3] above the plane."""
        return points @ self.normal - self.offset

    def met(self, rays: np.ndarray, to_camera: np.ndarray) -> np.ndarray:
        """How many times its ray [..., 3] lies between a camera [4, 4] and the plane [...]; inf where the ray does not
        go down to it."""
        eye = -to_camera[:3, :3].T @ to_camera[:3, 3]
        slope, fall = rays @ self.normal, self.offset - eye @ self.normal
        down = (slope < -1e-6) & (fall < 0)
        return np.where(down, fall / np.where(down, slope, -1.0), np.inf)

    def square(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(vertices float32 [4, 3], faces int32 [2, 3]) of a square of the plane below `points` [P, 3], facing up."""
        side = np.linalg.svd(self.normal[None])[2][1:]
        side[1] *= np.sign(np.cross(*side) @ self.normal)
        flat = np.asarray(points, np.float64) @ side.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        corners = (low + high) / 2 + (high - low).max() / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        vertices = self.offset * self.normal + corners @ side
        return vertices.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32)

    @property
    def is_table(self) -> bool:
        """Whether it goes on beside what stands on it."""
        return self.under < _BASE


def plane_below(
    vertices: np.ndarray, faces: np.ndarray, cameras: np.ndarray, tolerance: float, seed: int = 0
) -> Plane | None:
    """`find_plane` of a mesh, [V, 3] and [F, 3], under cameras at [N, 3]."""
    corners = vertices[faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1)
    good = length > 0
    normals = across[good] / length[good, None]
    return find_plane(corners[good].mean(axis=1), normals, length[good] / 2, cameras, tolerance, seed)


def find_plane(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, cameras: np.ndarray, tolerance: float, seed: int = 0
) -> Plane | None:
    """The plane with the most area of a surface within `tolerance`, that 95 % of the cameras look down on.

    points, normals, areas  [P, 3], unit [P, 3] and [P] of the surface's faces
    cameras                 [N, 3] positions
    By RANSAC (Fischler and Bolles 1981): a plane through a face's point along its normal is tried, faces turned by more
    than 30 degrees from it have no say; then least squares over those that lie in it. None where no plane holds 3 % of
    the area, or nothing stands on it.
    """
    if len(points) < 3:
        return None
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(points), size=min(_SAMPLES, len(points)), p=areas / areas.sum())
    points_, normals_ = points[chosen], normals[chosen]
    best, most = None, 0
    for k in rng.choice(len(chosen), size=min(_TRIALS, len(chosen)), replace=False):
        normal, offset = normals_[k], float(normals_[k] @ points_[k])
        if (cameras @ normal > offset).mean() < _CAMERAS:
            continue
        count = int(_in_plane(points_, normals_, normal, offset, tolerance).sum())
        if count > most:
            best, most = (normal, offset), count
    if best is None or most < _LEAST * len(chosen):
        return None
    normal, offset = best
    for _ in range(3):
        inside = points_[_in_plane(points_, normals_, normal, offset, tolerance)]
        middle = inside.mean(0)
        fitted = np.linalg.svd(inside - middle, full_matrices=False)[2][2]
        normal = fitted if fitted @ normal > 0 else -fitted
        offset = float(normal @ middle)
    if (cameras @ normal > offset).mean() < _CAMERAS:
        return None
    inside = _in_plane(points_, normals_, normal, offset, tolerance)
    above = points_ @ normal - offset > _ABOVE * tolerance
    if above.sum() < 10:
        return None
    return Plane(
        normal, offset, float(inside.mean()), _under(points_[inside], points_[above], normal, 2 * _ABOVE * tolerance)
    )


def _in_plane(
    points: np.ndarray, normals: np.ndarray, normal: np.ndarray, offset: float, tolerance: float
) -> np.ndarray:
    return (np.abs(points @ normal - offset) < tolerance) & (normals @ normal > _FACING)


def _under(plane: np.ndarray, above: np.ndarray, normal: np.ndarray, cell: float) -> float:
    """Share of the plane's points that lie in the convex outline of what is above it, seen along the normal.

    What lies in cells that touch is one group.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    flat = above @ across.T
    place = np.floor((flat - flat.min(axis=0)) / cell).astype(int)
    taken = np.zeros(place.max(axis=0) + 1, bool)
    taken[tuple(place.T)] = True
    group = label(taken, np.ones((3, 3)))[0][tuple(place.T)]
    large = np.bincount(group) >= _PART * len(above)
    try:
        outline = ConvexHull(flat[large[group]]).equations
    except (QhullError, ValueError):
        return 0.0
    return float(((plane @ across.T) @ outline[:, :2].T + outline[:, 2] <= 0).all(axis=1).mean())
