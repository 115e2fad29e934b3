"""Do a camera file's pixel centres lie at whole numbers, or at halves? Asked of matches between the pictures."""

from __future__ import annotations

import numpy as np

from exmesh_graph.io.checks.epipolar import Offset, principal_offset
from exmesh_graph.io.checks.features import alike, match_pairs
from exmesh_graph.io.checks.readings import Cameras
from exmesh_graph.io.shots import spread

USUAL = 0.5
_PAIRS = 100
_SURE = 2.5


def find_half_pixel(pictures: np.ndarray, cameras: Cameras, scale: float) -> tuple[float, Offset | None, bool]:
    """(what is to be added to the file's principal point: 0 or 0.5, the estimate, whether matches decide).

    pictures  float32 [N, H, W, 3], display values; `cameras` have the file's own principal point in these pixels
    scale     pixels of the file in one of these

    The offset that fits matches of each picture with its four nearest in looks is the nearer of the two where it keeps
    two and a half standard errors from the middle between them; else 0.5 is taken, which most files need.
    """
    listed = alike(pictures, 4)
    found = principal_offset(match_pairs(pictures, [listed[i] for i in spread(len(listed), _PAIRS)]), cameras)
    if found is None:
        return USUAL, None, False
    full = Offset(found.best * scale, found.error * scale, found.matches)
    if abs(full.best - USUAL / 2) < _SURE * full.error:
        return USUAL, full, False
    return (USUAL if full.best > USUAL / 2 else 0.0), full, True


def told(offset: float, found: Offset | None, decided: bool) -> str:
    """A sentence on it for the user."""
    if found is None:
        return f"too few matches to tell where the camera file's pixel centres lie: pixel_offset {offset:g} is taken"
    figures = f"{found.matches} matches ask for {found.best:.2f} +- {found.error:.2f} px on the principal point"
    if decided:
        return f"{figures}: pixel_offset {offset:g} is taken"
    return f"{figures}, which does not tell 0 from 0.5: pixel_offset {offset:g} is taken; set it if you know"


def display(images: np.ndarray) -> np.ndarray:
    """Linear pictures as matches want them: roughly even in brightness (square root)."""
    return np.sqrt(np.clip(images, 0, 1))
