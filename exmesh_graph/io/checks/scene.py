"""What the loaders ask: before the world is normalised, do cameras, masks and pictures agree; after it, the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from exmesh_graph.io.cameras import scale_intrinsics
from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.half_pixel import display, find_half_pixel, told
from exmesh_graph.io.checks.lens import check_lens
from exmesh_graph.io.checks.light import check_light, mean_colours
from exmesh_graph.io.checks.masks import check_masks
from exmesh_graph.io.checks.outlines import Outlines
from exmesh_graph.io.checks.pictures import check_pictures
from exmesh_graph.io.checks.places import check_places
from exmesh_graph.io.checks.readings import Cameras

if TYPE_CHECKING:
    from exmesh_graph.io.load import Loaded

_SIDE = 400


def check_cameras(fit: Loaded, wrong_masks: int) -> list[Finding]:
    """Training cameras against masks (`wrong_masks` of which may be wrong), or against the pictures without masks."""
    outlines = _outlines(fit)
    if outlines is not None:
        findings, supported = check_masks(outlines, wrong_masks)
    else:
        pictures, small, _ = _small(fit)
        findings, supported = check_pictures(pictures, small)
    height, width = fit.alpha.shape[1:]
    cameras = Cameras(fit.names, fit.intrinsics, fit.camera_to_world, width, height)
    lens = check_lens(cameras, supported)
    explained = any(finding.explained for finding in findings)
    return [*findings, *lens] if explained else [*lens, *findings]  # what tells the cause comes first


def principal_shift(fit: Loaded) -> tuple[float, str]:
    """(0 or 0.5 to be added to the files' principal points, a note where the matches do not tell)."""
    pictures, cameras, scale = _small(fit)
    offset, found, decided = find_half_pixel(pictures, cameras, scale * fit.downscale)
    return offset, "" if decided else told(offset, found, decided)


def check_world(fit: Loaded, held: Loaded, centre: np.ndarray, radius: float, given: bool) -> list[Finding]:
    """Cameras against the object's sphere (data set's units; `given` by the user or the files), train against test."""
    height, width = fit.alpha.shape[1:]
    cameras = Cameras(fit.names, fit.intrinsics, fit.camera_to_world, width, height)
    train, test = ((mean_colours(part.images, part.alpha), part.camera_to_world[:, :3, 3]) for part in (fit, held))
    return [
        *check_places(cameras, centre, radius, _outlines(fit), given),
        *check_light(train, test, centre, held.names),
    ]


def _outlines(fit: Loaded) -> Outlines | None:
    """The views that have a mask; None where none has."""
    rows = np.flatnonzero((fit.silhouettes < 1).any(axis=(1, 2)))
    if not fit.has_masks or not len(rows):
        return None
    height, width = fit.silhouettes.shape[1:]
    cameras = Cameras(fit.names, fit.silhouette_intrinsics, fit.camera_to_world, width, height)
    return Outlines.of(fit.silhouettes[rows] >= 0.5, cameras.subset(rows))


def _small(fit: Loaded) -> tuple[np.ndarray, Cameras, int]:
    """(display values of the pictures at about 400 pixels, their cameras, by how much they were reduced)."""
    height, width = fit.alpha.shape[1:]
    factor = max(1, round(max(height, width) / _SIDE))
    rows, columns = height // factor, width // factor
    cells = (rows, factor, columns, factor, 3)
    blocks = np.stack(
        [image[: rows * factor, : columns * factor].reshape(cells).mean(axis=(1, 3)) for image in fit.images]
    )
    k = scale_intrinsics(fit.intrinsics, factor)
    return display(blocks), Cameras(fit.names, k, fit.camera_to_world, columns, rows), factor
