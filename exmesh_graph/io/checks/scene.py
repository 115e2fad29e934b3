"""What the loaders ask: before the world is normalised, do cameras, masks and pictures agree; after it, the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from exmesh_graph.io.checks.finding import Finding
from exmesh_graph.io.checks.lens import check_lens
from exmesh_graph.io.checks.light import check_light, mean_colours
from exmesh_graph.io.checks.masks import check_masks
from exmesh_graph.io.checks.outlines import Outlines
from exmesh_graph.io.checks.places import check_places
from exmesh_graph.io.checks.readings import Cameras

if TYPE_CHECKING:
    from exmesh_graph.io.load import Loaded


def check_cameras(fit: Loaded, wrong_masks: int) -> list[Finding]:
    """Training cameras against masks and pictures; `wrong_masks` of the masks are allowed to be wrong."""
    outlines = _outlines(fit)
    findings, supported = check_masks(outlines, wrong_masks) if outlines is not None else ([], False)
    height, width = fit.alpha.shape[1:]
    cameras = Cameras(fit.names, fit.intrinsics, fit.camera_to_world, width, height)
    return [*findings, *check_lens(cameras, supported)]


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
