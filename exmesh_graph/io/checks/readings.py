"""Other ways in which a camera file may have been meant: tried where it does not fit the pictures as it is read.

A reading changes cameras as `cameras.py` would have to: poses [N, 4, 4] (camera-to-world, OpenCV), intrinsics
[N, 3, 3], which camera belongs to which picture, and whether pictures are turned over before they are used.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_SIZES = ((2, "half"), (3, "a third of"), (4, "a quarter of"))


@dataclass(frozen=True)
class Cameras:
    """Cameras of N pictures of one size, in any world.

    intrinsics float64 [N, 3, 3], pixel centres at +0.5; camera_to_world float64 [N, 4, 4], rigid, OpenCV axes
    """

    names: tuple[str, ...]
    intrinsics: np.ndarray
    camera_to_world: np.ndarray
    width: int
    height: int

    def subset(self, rows: Sequence[int] | np.ndarray) -> Cameras:
        chosen = [int(row) for row in rows]
        names = tuple(self.names[row] for row in chosen)
        return replace(
            self, names=names, intrinsics=self.intrinsics[chosen], camera_to_world=self.camera_to_world[chosen]
        )

    def project(self, view: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(x, y, depth) [P] of points [P, 3] in one view; x and y mean nothing where depth <= 0."""
        matrix = self.intrinsics[view] @ np.linalg.inv(self.camera_to_world[view])[:3]
        x, y, depth = matrix[:, :3] @ points.T + matrix[:, 3:]
        inverse = 1 / np.where(depth > 0, depth, 1)
        return x * inverse, y * inverse, depth


def _same(cameras: Cameras) -> Cameras:
    return cameras


@dataclass(frozen=True)
class Reading:
    """`change` gives the cameras as they may have been meant; `over`: pictures mirrored in (x, y); masks `inverted`."""

    cause: str
    cure: str
    change: Callable[[Cameras], Cameras] = field(default=_same)
    over: tuple[bool, bool] = (False, False)
    inverted: bool = False


def readings(cameras: Cameras) -> Iterator[Reading]:
    """The likely ones first."""
    yield from _sizes(cameras)
    yield Reading(
        "the camera axes are those of the other convention (OpenCV: y down, looking along +z; OpenGL, Blender: y up, "
        "looking along -z)",
        "multiply the second and third column of every camera-to-world matrix by -1",
        lambda c: replace(c, camera_to_world=c.camera_to_world @ _FLIP),
    )
    inverse = "the matrices are world-to-camera, the loader reads camera-to-world"
    yield Reading(inverse, "invert every matrix", lambda c: replace(c, camera_to_world=_inverse(c)))
    yield Reading(
        f"{inverse}, and their axes are those of the other convention (OpenCV, OpenGL)",
        "invert every matrix, then multiply its second and third column by -1",
        lambda c: replace(c, camera_to_world=_inverse(c) @ _FLIP),
    )
    yield Reading(
        "the rotations are transposed, the positions are not", "transpose the 3 x 3 part of every matrix", _transposed
    )
    yield Reading(
        "the last column is the translation of world-to-camera, the rotation that of camera-to-world",
        "put -R t in place of t, R the 3 x 3 part of the matrix", _moved,
    )  # fmt: skip
    for axis, mirror in (("x", (-1, 1, 1, 1)), ("y", (1, -1, 1, 1)), ("z", (1, 1, -1, 1))):
        yield Reading(
            f"the cameras are those of a left-handed world (mirrored along their {axis} axis)",
            "export the cameras in a right-handed world, or mirror the pictures and masks",
            partial(_mirrored, mirror=np.diag(mirror).astype(float)),
        )
    for over, how in (
        ((True, False), "mirrored left to right"),
        ((False, True), "mirrored top to bottom"),
        ((True, True), "turned by 180 degrees"),
    ):
        yield Reading(
            f"pictures are {how} against the cameras", "use the pictures that the cameras were made for", over=over
        )
    yield Reading("the masks are white on the background", "invert the masks", inverted=True)
    yield from _orders(cameras)


def focal_lengths() -> Iterator[Reading]:
    """Other focal lengths for all pictures."""
    for off in (0.67, 0.8, 1.25, 1.5):
        yield Reading(
            f"the focal length is about {1 / off:.2f} times what it should be", "find or export the cameras again",
            partial(_scaled, scale=off, columns=2),
        )  # fmt: skip


def _sizes(cameras: Cameras) -> Iterator[Reading]:
    for factor, name in _SIZES:
        for scale, size, remedy in (
            (1 / factor, f"{name} the size", f"divide by {factor}"),
            (factor, f"{factor} times the size", f"multiply by {factor}"),
        ):
            yield Reading(
                f"the pictures have {size} that the camera file is for",
                f"{remedy} its focal lengths and principal point, or use the pictures it was made for",
                partial(_scaled, scale=scale),
            )
            yield Reading(
                f"the pictures have {size} that the focal length in the camera file is for",
                f"{remedy} the focal lengths in the camera file",
                partial(_scaled, scale=scale, columns=2),
            )
    yield from focal_lengths()
    if cameras.width != cameras.height:
        yield Reading(
            "the camera file is for pictures that are turned by 90 degrees (portrait, landscape)",
            "use the pictures as they were when the cameras were found, or find the cameras again",
            _turned,
        )


def _orders(cameras: Cameras) -> Iterator[Reading]:
    count = len(cameras.names)
    orders = [
        ("one place too early", np.roll(np.arange(count), -1)),
        ("one place too late", np.roll(np.arange(count), 1)),
        ("in reverse", np.arange(count)[::-1]),
    ]
    natural = sorted(range(count), key=lambda i: _natural(cameras.names[i]))
    plain = sorted(range(count), key=lambda i: cameras.names[i])
    if natural != plain:
        by_number = np.empty(count, int)
        by_number[plain] = natural
        orders.append(("in the order 1, 10, 11, ..., 2 where the others have 1, 2, 3, ...", by_number))
        back = np.empty(count, int)
        back[natural] = plain
        orders.append(("in the order 1, 2, 3, ... where the others have 1, 10, 11, ..., 2", back))
    for how, order in orders:
        yield Reading(
            f"the cameras are listed {how}: they belong to other pictures",
            "list pictures and cameras in one order",
            partial(_ordered, order=order),
        )


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def _scaled(cameras: Cameras, scale: float, columns: int = 3) -> Cameras:
    """K times `scale`: all of it, or (`columns` 2) the focal lengths."""
    k = cameras.intrinsics.copy()
    k[:, :2, :columns] *= scale
    return replace(cameras, intrinsics=k)


def _mirrored(cameras: Cameras, mirror: np.ndarray) -> Cameras:
    return replace(cameras, camera_to_world=mirror @ cameras.camera_to_world @ mirror)


def _ordered(cameras: Cameras, order: np.ndarray) -> Cameras:
    return replace(cameras, intrinsics=cameras.intrinsics[order], camera_to_world=cameras.camera_to_world[order])


def _inverse(cameras: Cameras) -> np.ndarray:
    return np.linalg.inv(cameras.camera_to_world)


def _transposed(cameras: Cameras) -> Cameras:
    poses = cameras.camera_to_world.copy()
    poses[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    return replace(cameras, camera_to_world=poses)


def _moved(cameras: Cameras) -> Cameras:
    poses = cameras.camera_to_world.copy()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return replace(cameras, camera_to_world=poses)


def _turned(cameras: Cameras) -> Cameras:
    k = cameras.intrinsics.copy()
    k[:, [0, 1], [0, 1]] = k[:, [1, 0], [1, 0]]
    k[:, [0, 1], 2] = k[:, [1, 0], 2]
    return replace(cameras, intrinsics=k)
