"""Which way is up in a world that was found from pictures alone.

The camera's right is level in most pictures, whichever way up they lie, so the vertical is what is at right angles to
all of them; its sign needs the pictures' own up, or, where half of them are upside down, that people look down on what
they photograph more than up.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.io.cameras import rotation_to_y, scene_from_dataset

_AGREED = 0.25
"""Mean component along the vertical of the cameras' own up: below, pictures lie some one way up, some the other."""
_DOWN = 0.1
"""Mean component of the viewing directions along the vertical that tells the side from which cameras look down."""


def upright_world(poses: np.ndarray) -> tuple[np.ndarray, str]:
    """(rotation [4, 4] that makes the world Y-up, a note where it is a guess) of poses [N, 4, 4],
    camera-to-world with OpenCV axes.

    In this order: level cameras; cameras that all lie on their side; the mean of the cameras' own up.
    """
    found = _upright(poses)
    return found or (_mean_up(poses), "the cameras do not tell which way is up: the mean of their own is taken")


def turntable_axis(poses: np.ndarray) -> np.ndarray | None:
    """Unit [3], pointing up: what the cameras [N, 4, 4] stand around; None where they do not tell."""
    found = _upright(np.asarray(poses, np.float64))
    return None if found is None else found[0][1, :3]


def _upright(poses: np.ndarray) -> tuple[np.ndarray, str] | None:
    note = ""
    try:
        rotation = scene_from_dataset("auto", poses)
    except DataError:
        try:  # turned by a quarter: the camera's down is level
            rotation = scene_from_dataset("auto", poses[:, :, [1, 0, 2, 3]])
            note = "the pictures lie on their side: the axis that the cameras go around is taken for the vertical"
        except DataError:
            return None
    own = float(-(rotation[:3, :3] @ poses[:, :3, 1].T)[1].mean())
    if abs(own) >= _AGREED:
        return _facing(rotation, own), note
    down = float(-(rotation[:3, :3] @ poses[:, :3, 2].T)[1].mean())
    if abs(down) >= _DOWN:
        told = note or "some pictures are upside down"
        return _facing(rotation, down), f"{told}, and up is the side from which most look down"
    return rotation, f"{note or 'some pictures are upside down'}, and which end of it is up is a guess"


def _facing(rotation: np.ndarray, sign: float) -> np.ndarray:
    return rotation if sign > 0 else np.diag([1.0, -1.0, -1.0, 1.0]) @ rotation


def _mean_up(poses: np.ndarray) -> np.ndarray:
    up = -poses[:, :3, 1].mean(0)
    rotation = np.eye(4)
    rotation[:3, :3] = rotation_to_y(up / max(float(np.linalg.norm(up)), 1e-12))
    return rotation
