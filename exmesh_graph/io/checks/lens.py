"""Intrinsics that do not go with the pictures: principal point, field of view, ratio of the focal lengths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.readings import Cameras

_AWRY, _CORNER = 0.1, 0.22  # of the picture's side, from its middle
_NARROW, _WIDE = (3.0, 1.0), (105.0, 130.0)  # degrees: odd, hardly possible
_SQUARE = 1.15


def check_lens(cameras: Cameras, supported: bool) -> list[Finding]:
    """Findings on K alone; `supported` says that masks or matches agree with these cameras: then none is grave."""
    width, height = cameras.width, cameras.height
    k = cameras.intrinsics
    findings = []
    off = np.stack([k[:, 0, 2] / width - 0.5, k[:, 1, 2] / height - 0.5], axis=1)
    far = np.abs(off).max(axis=1)
    # a crop moves the principal point, and is no fault where everything else agrees
    if (far > (_CORNER if supported else _AWRY)).any():
        rows = np.flatnonzero(far > _AWRY)
        first = rows[far[rows].argmax()]
        cause, cure = _why_off(cameras, int(first))
        findings.append(Finding(
            "principal point",
            f"the principal point is at ({k[first, 0, 2]:.0f}, {k[first, 1, 2]:.0f}) in pictures of {width} x {height}",
            cause, cure, _named(cameras, rows), grave=bool((far > _CORNER).any()) and not supported,
        ))  # fmt: skip
    angle = np.degrees(2 * np.arctan(width / 2 / k[:, 0, 0]))
    findings += _angles(cameras, angle, supported)
    ratio = k[:, 0, 0] / k[:, 1, 1]
    uneven = np.maximum(ratio, 1 / ratio) > _SQUARE
    if uneven.any():
        rows = np.flatnonzero(uneven)
        findings.append(Finding(
            "pixels", f"the focal lengths in x and y differ by {abs(ratio[rows[0]] - 1):.0%}",
            "the pictures were stretched, or the values are of two picture sizes",
            "use the pictures the cameras were made for, or correct fl_x and fl_y", _named(cameras, rows), grave=False,
        ))  # fmt: skip
    return findings


def _angles(cameras: Cameras, angle: np.ndarray, supported: bool) -> list[Finding]:
    sides: tuple[tuple[Callable[[np.ndarray, float], np.ndarray], tuple[float, float], str], ...] = (
        (np.less, _NARROW, "for larger pictures"), (np.greater, _WIDE, "for smaller pictures"),
    )  # fmt: skip
    findings = []
    for beyond, (odd, impossible), why in sides:
        rows = np.flatnonzero(beyond(angle, odd))
        if len(rows) and not supported:
            findings.append(Finding(
                "focal length", f"the field of view is {angle[rows[0]]:.1f} degrees across the picture",
                f"the focal length is in other units than pixels of these pictures (millimetres, radians for degrees), "
                f"or {why}", "give the focal length in pixels of the pictures that are there",
                _named(cameras, rows), grave=bool(beyond(angle, impossible).any()),
            ))  # fmt: skip
    return findings


def _why_off(cameras: Cameras, view: int) -> tuple[str, str]:
    """(cause, cure) of a principal point far from the middle."""
    width, height = cameras.width, cameras.height
    x, y = cameras.intrinsics[view, :2, 2]
    across, down = 2 * x / width, 2 * y / height
    if across > 0 and down > 0 and abs(np.log(across / down)) < 0.1:
        return (
            f"the camera file is for pictures of about {round(2 * x)} x {round(2 * y)}",
            f"divide its focal lengths and principal point by {across:.4g}, or use pictures of that size",
        )
    if width != height and abs(2 * x / height - 1) < 0.1 and abs(2 * y / width - 1) < 0.1:
        return "the camera file is for pictures turned by 90 degrees", "use the pictures as they were taken"
    return (
        "the pictures were cropped after the cameras were found, or cx and cy are wrong",
        "take the crop's corner from cx and cy, or use the whole pictures",
    )


def _named(cameras: Cameras, rows: np.ndarray) -> tuple[str, ...]:
    return () if len(rows) == len(cameras.names) else tuple(cameras.names[row] for row in rows)
