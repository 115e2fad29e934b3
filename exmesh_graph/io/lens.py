"""Lenses as other programs describe them, and lenses behind pictures that were turned or reduced since.

Of a ray (X, Y, Z) in OpenCV's camera axes, x = X / Z, y = Y / Z, r^2 = x^2 + y^2 (Brown 1966, as OpenCV and Agisoft
write it; Kannala and Brandt 2006 for fisheyes, where theta is the angle to the axis):

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + ...) + p1 (r^2 + 2 y^2) + 2 p2 x y
    of fisheyes, x theta / r and y theta / r take the places of x and y, so theta that of r
    u = fx x' + skew y' + cx,   v = fy y' + cy                                    pixel centres at +0.5
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from exmesh_graph.io.cameras import reduced_size

_ROUNDS = 20


class AnyLens(Protocol):
    """What a lens is to the loaders; pycolmap's cameras are such lenses."""

    @property
    def width(self) -> int:
        """Of the picture, pixels."""

    @property
    def height(self) -> int:
        """Of the picture, pixels."""

    def calibration_matrix(self) -> np.ndarray:
        """float64 [3, 3], without distortion."""

    def img_from_cam(self, cam_points: np.ndarray) -> np.ndarray:
        """Pixels [P, 2] of rays [P, 3]."""


@dataclass(frozen=True)
class Lens:
    """The formula above for pictures of width x height pixels."""

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    radial: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0
    fisheye: bool = False

    @property
    def straight(self) -> bool:
        """Whether it is a pinhole."""
        return not (self.fisheye or any(self.radial) or any(self.tangential) or self.skew)

    def calibration_matrix(self) -> np.ndarray:
        """As `AnyLens`."""
        return np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1.0]])

    def img_from_cam(self, cam_points: np.ndarray) -> np.ndarray:
        """As `AnyLens`."""
        x, y = cam_points[:, 0] / cam_points[:, 2], cam_points[:, 1] / cam_points[:, 2]
        if self.fisheye:
            r = np.maximum(np.hypot(x, y), 1e-9)
            x, y = x * np.arctan(r) / r, y * np.arctan(r) / r
        r2 = x**2 + y**2
        bend = self._series(r2)
        p1, p2 = self.tangential
        u = x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        v = y * bend + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        return np.stack(
            [self.focal[0] * u + self.skew * v + self.centre[0], self.focal[1] * v + self.centre[1]], axis=1
        )

    def _series(self, square: np.ndarray) -> np.ndarray:
        value = np.ones_like(square)
        for power, k in enumerate(self.radial, start=1):
            value = value + k * square**power
        return value


@dataclass(frozen=True)
class Behind:
    """A lens as it is behind a picture that was turned by `quarter` quarters to the left and then reduced by `factor`,
    what fills no pixel left off at both sides alike (`io.reduce.area_means`)."""

    lens: AnyLens
    quarter: int = 0
    factor: float = 1.0

    @property
    def width(self) -> int:
        """As `AnyLens`."""
        return self._size()[0]

    @property
    def height(self) -> int:
        """As `AnyLens`."""
        return self._size()[1]

    @property
    def params(self) -> tuple[float, float, float, float]:
        """Focal lengths and principal point."""
        k = self.calibration_matrix()
        return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])

    def calibration_matrix(self) -> np.ndarray:
        """As `AnyLens`."""
        k = np.array(self.lens.calibration_matrix(), np.float64)
        focal = k[[0, 1], [0, 1]][:: -1 if self.quarter % 2 else 1] / self.factor
        centre = self._of_file(k[None, :2, 2])[0]
        return np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1.0]])

    def img_from_cam(self, cam_points: np.ndarray) -> np.ndarray:
        """As `AnyLens`, for rays in the axes of the camera that was turned with its picture."""
        rays = np.asarray(cam_points, np.float64) @ turn(self.quarter)[:3, :3].T
        return self._of_file(np.asarray(self.lens.img_from_cam(rays)))

    def in_file(self, pixels: np.ndarray) -> np.ndarray:
        """Where pixels [..., 2] of the picture lie in the file's."""
        wide, high = self._turned()
        at = (pixels - np.array([self.width, self.height]) / 2) * self.factor + np.array([wide, high]) / 2
        for _ in range(self.quarter % 4):  # each turns back to the right
            wide, high = high, wide
            at = np.stack([wide - at[..., 1], at[..., 0]], axis=-1)
        return at

    def _of_file(self, pixels: np.ndarray) -> np.ndarray:
        at, wide, high = pixels, self.lens.width, self.lens.height
        for _ in range(self.quarter % 4):
            at = np.stack([at[..., 1], wide - at[..., 0]], axis=-1)
            wide, high = high, wide
        return (at - np.array([wide, high]) / 2) / self.factor + np.array([self.width, self.height]) / 2

    def _turned(self) -> tuple[int, int]:
        size = self.lens.width, self.lens.height
        return size[::-1] if self.quarter % 2 else size

    def _size(self) -> tuple[int, int]:
        return reduced_size(self._turned(), self.factor)


@dataclass(frozen=True)
class LensChange:
    """What lenses are other than they were taken for: longer by exp(`growth`), and bent by more of r^2, by `bend`.

    What a pinhole shows at u = (X / Z, Y / Z), the lens that was taken for straight shows at

        q = exp(g) u (1 + b r^2),    r = |u|
    """

    growth: float = 0.0
    bend: float = 0.0

    @property
    def zoom(self) -> float:
        """What focal lengths are times those before."""
        return float(np.exp(self.growth))

    def longer(self, intrinsics: np.ndarray) -> np.ndarray:
        """Intrinsics [..., 3, 3] with focal lengths as long as they are."""
        matrix = np.array(intrinsics, np.float64)
        matrix[..., [0, 1], [0, 1]] *= self.zoom
        return matrix

    def shown(self, rays: np.ndarray) -> np.ndarray:
        """q [..., 2] of u [..., 2]."""
        return self.zoom * rays * (1 + self.bend * np.square(rays).sum(axis=-1, keepdims=True))

    def rays(self, shown: np.ndarray) -> np.ndarray:
        """u [..., 2] of q [..., 2], by iteration."""
        straight = shown / self.zoom
        if not self.bend:
            return np.asarray(straight)
        begun = straight[..., 0] ** 2 + straight[..., 1] ** 2
        square = begun
        for _ in range(_ROUNDS):
            square = begun / (1 + self.bend * square) ** 2
        return np.asarray(straight / (1 + self.bend * square)[..., None])


#: Lenses are what they were taken for.
UNCHANGED = LensChange()


@dataclass(frozen=True)
class Changed:
    """A lens as it is after all."""

    lens: AnyLens
    change: LensChange

    @property
    def width(self) -> int:
        """As `AnyLens`."""
        return self.lens.width

    @property
    def height(self) -> int:
        """As `AnyLens`."""
        return self.lens.height

    def calibration_matrix(self) -> np.ndarray:
        """As `AnyLens`."""
        return self.change.longer(self.lens.calibration_matrix())

    def img_from_cam(self, cam_points: np.ndarray) -> np.ndarray:
        """As `AnyLens`."""
        shown = self.change.shown(cam_points[:, :2] / cam_points[:, 2:])
        return np.asarray(self.lens.img_from_cam(np.concatenate([shown, np.ones((len(shown), 1))], axis=1)))


def turn(quarter: int) -> np.ndarray:
    """[4, 4]: what a camera's pose is multiplied with from the right when its picture is turned so many quarters to
    the left."""
    one = np.eye(4)
    one[:2, :2] = [[0, -1], [1, 0]]  # the new right is the old down, the new down the old left
    return np.linalg.matrix_power(one, quarter % 4)
