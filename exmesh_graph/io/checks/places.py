"""Where cameras stand: inside the object or its box, or looking away from it."""

from __future__ import annotations

import numpy as np

from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.outlines import Outlines, holds
from exmesh_graph.io.checks.readings import Cameras

_MANY = 0.5
_SMALL = 0.05  # of the picture


def check_places(
    cameras: Cameras, centre: np.ndarray, radius: float, outlines: Outlines | None, given: bool
) -> list[Finding]:
    """Findings on cameras against the object's sphere, which was `given` by the file or a box, or found.

    Where there are masks, a camera is inside the object if all other masks hold its place; else, and where a given
    sphere holds most cameras, if it is in the sphere.
    """
    places = cameras.camera_to_world[:, :3, 3]
    distance = np.linalg.norm(places - centre, axis=1)
    inside = distance < radius
    sphere_wrong = given and inside.mean() >= _MANY
    if outlines is not None and inside.any() and not sphere_wrong:
        inside &= _in_all_masks(outlines, places)
    findings = []
    if inside.any():
        whose = "the object that the masks show" if outlines is not None and not sphere_wrong else "the object's sphere"
        cause = (
            "the box (or scale_mat) is in other units than the cameras' positions, or too large" if given
            else "positions are in other units than the rest, or the object does not stand amidst the cameras"
        )  # fmt: skip
        findings.append(Finding(
            "inside", f"{inside.sum()} of {len(inside)} cameras stand inside {whose}", cause,
            "give the box in the units of the camera file" if given else "correct the positions, or give `box`",
            _named(cameras, inside), grave=bool(inside.mean() >= _MANY),
        ))  # fmt: skip
    elif given:
        sides = radius / np.maximum(distance, 1e-12) * cameras.intrinsics[:, 0, 0] * 2 / cameras.width
        if np.median(sides) < _SMALL:
            findings.append(Finding(
                "box", f"the object's box is {np.median(sides) * cameras.width:.1f} pixels wide in the pictures",
                "the box (or scale_mat) is in other units than the cameras' positions",
                "give the box in the units of the camera file",
            ))  # fmt: skip
    depth = np.einsum("ni,ni->n", centre - places, cameras.camera_to_world[:, :3, 2])
    behind = (depth < 0) & ~inside
    if behind.mean() >= _MANY:
        findings.append(Finding(
            "behind", f"the place around which the cameras stand lies behind {behind.sum()} of {len(behind)} of them",
            "the camera axes are those of the other convention (OpenCV: y down, looking along +z; OpenGL, Blender: y "
            "up, looking along -z)", "multiply the second and third column of every camera-to-world matrix by -1",
            _named(cameras, behind),
        ))  # fmt: skip
    return findings


def _in_all_masks(outlines: Outlines, places: np.ndarray) -> np.ndarray:
    votes = np.stack([holds(outlines, view, places) for view in range(len(outlines))])
    own = np.linalg.norm(outlines.cameras.camera_to_world[:, None, :3, 3] - places[None], axis=2) < 1e-9
    return (votes | own).all(axis=0)


def _named(cameras: Cameras, chosen: np.ndarray) -> tuple[str, ...]:
    return () if chosen.all() else tuple(np.array(cameras.names)[chosen].tolist())
