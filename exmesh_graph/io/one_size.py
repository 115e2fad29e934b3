"""Pictures of several sizes, shapes and lenses, with cameras that are given: one size for all, lenses undone.

The size that most have, portrait or landscape alike, is the set's, as for photographs without cameras (`io.working`).
The fewer of the two lie on their side, their cameras with them; others are reduced or enlarged until they just hold it
and cut to its shape. Nothing is padded: a border would count as background.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from exmesh_graph.io.cameras import intrinsics_from_fov
from exmesh_graph.io.images import picture_size
from exmesh_graph.io.lens import Behind, Lens, turn
from exmesh_graph.io.normalise import some
from exmesh_graph.io.shots import Shot
from exmesh_graph.io.undistort import pinhole


def of_one_size(shots: Sequence[Shot]) -> tuple[list[Shot], str]:
    """(shots that read alike, a note on those that lose or gain by it, or "").

    Shots whose file is missing, or of another size than its camera says, stay: reading them says so.
    """
    sizes = [picture_size(shot.image) if shot.image.is_file() else (0, 0) for shot in shots]
    whole = [size for shot, size in zip(shots, sizes, strict=True) if shot.places is None and shot.size in (None, size)]
    if len(whole) < len(shots) or not all(all(size) for size in sizes):
        return list(shots), ""
    target = common_shape(sizes)
    alike, odd, least = [], [], 1.0
    for shot, size in zip(shots, sizes, strict=True):
        lies = size[0] != size[1] and target[0] != target[1] and (size[0] > size[1]) != (target[0] > target[1])
        held = size[::-1] if lies else size
        if held == target and not lies and shot.lens is None:
            alike.append(shot)
            continue
        alike.append(_brought(shot, size, int(lies), target))
        if held != target:
            factor = max(target[0] / held[0], target[1] / held[1])
            least = min(least, target[0] * target[1] / (factor**2 * held[0] * held[1]))
            odd.append(shot.name)
    if not odd:
        return alike, ""
    return alike, brought_note(odd, len(shots), target, least)


def brought_note(odd: Sequence[str], count: int, target: tuple[int, int], least: float) -> str:
    """What is said of the pictures `odd` of `count`, of whose shapes one keeps the share `least` of its area."""
    return (
        f"{len(odd)} of {count} pictures have another size or shape than {target[0]} x {target[1]}, which most have, "
        f"and are brought to it; of the shape that differs most {100 * least:.0f} % of the area is kept: {some(odd)}"
    )


def common_shape(sizes: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """(width, height) that most have, lying or upright, and of these the way that more of them are; the larger of
    equally many, lying."""
    lying = Counter((min(size), max(size)) for size in sizes)
    short, long = max(lying, key=lambda size: (lying[size], size[0] * size[1], size))
    same = [size for size in sizes if (min(size), max(size)) == (short, long)]
    return (long, short) if sum(w > h for w, h in same) * 2 >= len(same) else (short, long)


def _brought(shot: Shot, size: tuple[int, int], quarter: int, target: tuple[int, int]) -> Shot:
    """The shot as `target` [width, height] holds it; its file is `size`, and is turned by `quarter` quarters."""
    k = shot.intrinsics if shot.intrinsics is not None else intrinsics_from_fov(shot.angle_x, *size)
    lens = shot.lens or Lens(*size, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]))
    intrinsics, places = _seen(lens, quarter, target)
    return replace(
        shot, intrinsics=intrinsics, places=places, size=target, lens=None,
        camera_to_world=shot.camera_to_world @ turn(quarter),
    )  # fmt: skip


@cache
def _seen(lens: Lens, quarter: int, target: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(K [3, 3], float32 [h, w, 2] pixels of the file), one for all pictures through a lens. Not to be written to."""
    behind = Behind(lens, quarter)
    if lens.straight:  # exactly: the largest part of its shape, reduced or enlarged
        factor = min(behind.width / target[0], behind.height / target[1])
        k = behind.calibration_matrix()
        middle = np.array([behind.width, behind.height]) / 2
        k[:2, 2] = (k[:2, 2] - middle) / factor + np.array(target) / 2
        k[[0, 1], [0, 1]] /= factor
        x, y = np.meshgrid(np.arange(target[0]) + 0.5, np.arange(target[1]) + 0.5)
        places = (np.stack([x, y], axis=-1) - np.array(target) / 2) * factor + middle
    else:
        k, places = pinhole(behind.img_from_cam, behind.calibration_matrix(), behind.width, behind.height, target)
    return k, behind.in_file(places).astype(np.float32)
