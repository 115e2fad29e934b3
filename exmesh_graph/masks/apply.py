"""Masks laid on photographs that have none, as loaders lay them on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from exmesh_graph.errors import DataError
from exmesh_graph.io.picture_files import Picture, with_pictures
from exmesh_graph.types import Views
from exmesh_graph.types.pictures import Pictures

_RIM = 0.6
"""Pixels: a cut knows no parts of pixels. The deviation of a pixel's box and of the half pixel it is placed to."""


def with_masks(views: Views, masks: Iterable[np.ndarray], where: str) -> Views:
    """The views with alpha from `masks`, one float32 [H, W] in [0, 1] a view: linear colour times alpha, black beside.

    A large set goes into files, as at loading. Raises DataError naming `where` for views that have masks, and for a
    mask without a pixel of at least 1/2.
    """
    if views.has_masks:
        raise DataError(
            "the views have masks already, and colours beside a mask are gone", where=where,
            expected="views that were loaded without masks", fix="load them with masks: false (data.idr: masks: none)",
        )  # fmt: skip
    masked = with_pictures(views, _cut_out(views, masks, where), views.height, views.width)
    return replace(masked, has_masks=True)


def _cut_out(views: Views, masks: Iterable[np.ndarray], where: str) -> Iterator[Picture]:
    for number, mask in enumerate(masks):
        if not (mask >= 0.5).any():
            raise DataError(
                "the mask is empty: no pixel has alpha >= 0.5", where=f"{where}, view {views.names[number]}",
                expected="a silhouette of the object", fix="leave this view out, or mend its mask",
            )  # fmt: skip
        yield views.images[number] * mask[..., None], mask, _codes(views.images, number)


def with_found_masks(views: Views, masks: np.ndarray, where: str) -> tuple[Views, list[str]]:
    """(the views that have pixels in `masks` bool [N, H, W], with these; names of the others). Raises as `with_masks`.

    DataError too where none has any.
    """
    seen = np.asarray(masks.any(axis=(1, 2)))
    if not seen.any():
        raise DataError(
            "no view shows the surface", where=where, expected="a surface of these views, in their world",
            fix="check that the surface comes from the same scene",
        )  # fmt: skip
    rows = np.flatnonzero(seen)
    bare = [name for name, one in zip(views.names, seen, strict=True) if not one]
    return with_masks(views.subset(rows), (soft(masks[row]) for row in rows), where), bare


def soft(inside: np.ndarray) -> np.ndarray:
    """Coverage float32 [H, W] in 256 steps of a mask bool [H, W], its rim spread over the pixels beside it."""
    spread = gaussian_filter(inside.astype(np.float32), _RIM, mode="nearest")
    return (np.rint(255 * spread) / 255).astype(np.float32)


def _codes(images: np.ndarray | Pictures, number: int) -> np.ndarray | None:
    """What the picture's file holds, where that may be kept."""
    if not isinstance(images, Pictures):
        return None
    codes = images.codes(number)
    return codes if codes.dtype.kind == "u" and codes.shape == images.shape[1:] else None
