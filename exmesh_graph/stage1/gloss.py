"""Gloss by place: by how much the brightness of a surface changes from view to view.

What is misplaced changes too, where colours differ from place to place. So what patches nearby differ by is taken off.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from exmesh_graph.geometry.patches import patches
from exmesh_graph.geometry.robust import robust
from exmesh_graph.stage1.exposure import CELLS, patch_colours, reduced_for_patches, separate
from exmesh_graph.types import Mesh, Views

_VIEWS = 5
"""Of a patch: fewer say nothing of how it changes."""
_REACH = 2.5
"""Cells around a patch in which colours are compared: a coarse surface may be so far off."""
_BESIDE, _NEAR = 3, 24
"""Patches that say how colours differ: so many at least, and at most."""
_MEDIAN = np.pi / 2
"""Of normal errors: the variance of a median over that of a mean."""

_FROM, _TO = 0.15, 0.65
"""Stops from which on a surface is firmer, and from which on it is as firm as it gets."""


def firmness(views: Views, mesh: Mesh, most: float) -> np.ndarray:
    """float32 [V]: 1 where the surface is matt, growing with its `gloss` to 1 + `most`."""
    return (1 + most * np.clip((gloss(views, mesh) - _FROM) / (_TO - _FROM), 0, 1)).astype(np.float32)


def gloss(views: Views, mesh: Mesh) -> np.ndarray:
    """float64 [V], in stops: the robust standard deviation over the views of the brightness around each vertex,
    exposures taken out, without what the surface around it differs by; 0 where too few views show it."""
    faces = np.asarray(mesh.faces)
    brightness = np.log2(patch_colours(reduced_for_patches(views), mesh).mean(-1, keepdims=True))
    stops, known = separate(brightness)
    level, spread, shown = robust((brightness - stops[:, None])[known])
    told = shown >= _VIEWS

    patch = patches(mesh.vertices, faces, CELLS)
    middle = np.asarray(mesh.vertices, np.float64)[faces].mean(1)
    size = np.bincount(patch, minlength=len(told))
    centres = np.stack([np.bincount(patch, middle[:, axis]) / size for axis in range(3)], axis=1)
    reach = _REACH / CELLS * float(np.ptp(middle, axis=0).max(initial=0))
    found = np.zeros(len(told))
    if told.sum() >= _BESIDE:
        away, near = cKDTree(centres[told]).query(centres, k=min(_NEAR, int(told.sum())), distance_upper_bound=reach)
        there, near = np.isfinite(away), np.where(np.isfinite(away), near, 0)
        count = there.sum(1)
        at = [np.where(there, values[told][near], np.nan) for values in (level[:, 0], spread, 1 / np.maximum(shown, 1))]
        beside = count >= _BESIDE
        mean = np.nansum(at[0], axis=1) / np.maximum(count, 1)
        paint = np.nansum((at[0] - mean[:, None]) ** 2, axis=1) / np.maximum(count, 1)
        own = robust(at[1].T[..., None])[0][:, 0] ** 2
        paint -= own * _MEDIAN * np.nansum(at[2], axis=1) / np.maximum(count, 1)
        found[beside] = np.sqrt(np.maximum(own - np.maximum(paint, 0), 0))[beside]
    vertices = len(mesh.vertices)
    total = np.bincount(faces.ravel(), np.repeat(found[patch], 3), minlength=vertices)
    return total / np.maximum(np.bincount(faces.ravel(), minlength=vertices), 1)
