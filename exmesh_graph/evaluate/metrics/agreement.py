"""Whether what photographs show on a surface is painted on it, or mirrored by it.

A mirror shows its surroundings behind itself. Neighbouring photographs agree on a surface there, each two on another,
so that stereo finds one; photographs from farther away show other things at the same point. Where a surface is
merely wrong (thin parts, outlines), neighbours do not agree either. Windows are compared by normalised
cross-correlation, as stereo and mesh refinement compare (Vu et al. 2012): light and exposure are no matter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from exmesh_graph.evaluate.metrics.rephotography import rephotograph
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.train_size import reduced
from exmesh_graph.types import Views

_WINDOW = 7  # pixels
_FILLED = 0.7  # of a window must lie on the surface
_STRUCTURE = 0.03  # deviation [display units] below which a window holds nothing that could be compared
_AGREED = 0.8  # correlation from which neighbours agree
_COUNT = 4  # photographs that are warped, near ones and far ones
_FAR = (20.0, 35.0, 60.0)  # degrees between viewing directions: least, wanted, most
_EVERY = 5  # photographs


class Reflected(NamedTuple):
    """`share` of the windows on which neighbours agree that are no more alike from far away than chance has it;
    `compared`: their share of the pictures."""

    share: float
    compared: float


def reflected(vertices: np.ndarray, faces: np.ndarray, views: Views, *, side: int = 256) -> Reflected:
    """Every fifth view beside its neighbours and beside views about 35 degrees away, warped over the mesh.

    vertices [V, 3], faces [F, 3] of a surface that was found by stereo; pictures are compared at a longer side of at
    most `side` pixels. A view without two others 20 to 60 degrees away has no say; where none has, both figures are 0.
    """
    small = reduced(views, max(1, -(-max(views.width, views.height) // side)))
    axes = views.camera_to_world[:, :3, 2]
    agreed = changed = pixels = 0
    for view in range(min(_EVERY // 2, len(views) - 1), len(views), _EVERY):
        angles = np.degrees(np.arccos(np.clip(axes @ axes[view], -1, 1)))
        angles[view] = np.inf
        away = np.where((angles > _FAR[0]) & (angles < _FAR[2]), np.abs(angles - _FAR[1]), np.inf)
        far = [int(k) for k in np.argsort(away, kind="stable")[:_COUNT] if np.isfinite(away[k])]
        if len(far) < 2:
            continue
        near = np.argsort(angles, kind="stable")[: min(_COUNT, len(views) - 1)]
        (likeness, counts), (beyond, there) = (_alike(vertices, faces, small, view, others) for others in (near, far))
        agree = counts & there & (likeness > _AGREED)
        agreed, changed, pixels = (
            agreed + int(agree.sum()),
            changed + int((beyond[agree] < 0).sum()),
            pixels + agree.size,
        )
    return Reflected(changed / max(agreed, 1), agreed / max(pixels, 1))


def _alike(
    vertices: np.ndarray, faces: np.ndarray, views: Views, view: int, others: np.ndarray | list[int]
) -> tuple[np.ndarray, np.ndarray]:
    left_out = views.subset(np.array([view]))
    made = rephotograph(vertices, faces, views.subset(np.sort(others)), left_out, nearest=_COUNT)
    known = made.seen[0] & (np.asarray(left_out.alpha[0]) > 0.5)
    return windows_alike(_grey(left_out.images[0]), _grey(made.images[0]), known)


def windows_alike(first: np.ndarray, second: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(normalised cross-correlation [H, W] of the windows around each pixel, bool [H, W] where it says something).

    first, second [H, W]; only pixels that are `known` bool [H, W] count. A window needs 70 % of them, and structure in
    the first picture.
    """
    weight = uniform_filter(known.astype(np.float64), _WINDOW, mode="constant")
    share = np.maximum(weight, 1e-9)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(uniform_filter(np.where(known, values, 0.0), _WINDOW, mode="constant")) / share

    first, second = first.astype(np.float64), second.astype(np.float64)
    one, other = mean(first), mean(second)
    spread = np.maximum(mean(first**2) - one**2, 0)
    product = spread * np.maximum(mean(second**2) - other**2, 0)
    likeness = (mean(first * second) - one * other) / np.sqrt(np.maximum(product, 1e-9))
    return likeness, known & (weight > _FILLED) & (spread > _STRUCTURE**2)


def _grey(linear: np.ndarray) -> np.ndarray:
    return linear_to_srgb(np.clip(np.asarray(linear), 0, 1)).mean(axis=-1)
