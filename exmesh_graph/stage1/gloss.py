"""Gloss by place: by how much the brightness of a surface changes from view to view.

What is misplaced changes too, where colours differ from place to place. So what patches nearby differ by is taken off.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from exmesh_graph.geometry.patches import patches
from exmesh_graph.geometry.robust import robust
from exmesh_graph.stage1.exposure import CELLS, patch_colours, separate
from exmesh_graph.types import Mesh, Views

_VIEWS = 5
"""Of a patch: fewer say nothing of how it changes."""
_REACH = 2.5
"""Cells around a patch in which colours are compared: a coarse surface may be so far off."""
_BESIDE, _NEAR = 3, 24
"""Patches that say how colours differ: so many at least, and at most."""
_MEDIAN = np.pi / 2
"""Of normal errors: the variance of a median over that of a mean."""

_FROM, _TO = 0.15, 0.4
"""Stops from which on a surface is firmer, and from which on it is as firm as it gets."""


def firmness(views: Views, mesh: Mesh, most: float) -> np.ndarray:
    """float32 [V]: 1 where the surface is matt, growing with its `gloss` to 1 + `most`."""
    return (1 + most * np.clip((gloss(views, mesh) - _FROM) / (_TO - _FROM), 0, 1)).astype(np.float32)


def gloss(views: Views, mesh: Mesh) -> np.ndarray:
    """float64 [V], in stops: the robust standard deviation over the views of the brightness around each vertex,
    exposures taken out, without what the surface around it differs by; 0 where too few views show it."""
    faces = np.asarray(mesh.faces)
    brightness = np.log2(patch_colours(views, mesh).mean(-1, keepdims=True))
    stops, known = separate(brightness)
    level, spread, shown = robust((brightness - stops[:, None])[known])
    patch = patches(mesh.vertices, faces, CELLS)
    middle = np.asarray(mesh.vertices, np.float64)[faces].mean(1)
    size = np.bincount(patch, minlength=len(shown))
    centres = np.stack([np.bincount(patch, middle[:, axis]) / size for axis in range(3)], axis=1)
    reach = _REACH / CELLS * float(np.ptp(middle, axis=0).max(initial=0))
    found = without_paint(centres, level[:, 0], spread, shown, reach)
    vertices = len(mesh.vertices)
    total = np.bincount(faces.ravel(), np.repeat(found[patch], 3), minlength=vertices)
    return total / np.maximum(np.bincount(faces.ravel(), minlength=vertices), 1)


def without_paint(
    centres: np.ndarray, level: np.ndarray, spread: np.ndarray, shown: np.ndarray, reach: float
) -> np.ndarray:
    """float64 [P], in stops: the median `spread` of the patches within `reach` of each one's centre, less the deviation
    of their `level` from one another beyond its own error, as variances; 0 where fewer than three can tell.

    centres [P, 3]; level, spread [P]: median and deviation over the `shown` [P] views of a patch; where these are fewer
    than five the patch tells nothing
    """
    told = np.flatnonzero(shown >= _VIEWS)
    if len(told) < _BESIDE:
        return np.zeros(len(centres))
    away, near = cKDTree(centres[told]).query(centres, k=min(_NEAR, len(told)), distance_upper_bound=reach)
    there = np.isfinite(away)
    near, count = told[np.where(there, near, 0)], there.sum(1)
    weight = there / np.maximum(count, 1)[:, None]
    own = robust(np.where(there, spread[near], np.nan).T[..., None])[0][:, 0] ** 2
    mean = (weight * level[near]).sum(1, keepdims=True)
    paint = (weight * (level[near] - mean) ** 2).sum(1) - own * _MEDIAN * (weight / shown[near]).sum(1)
    return np.where(count >= _BESIDE, np.sqrt(np.maximum(own - np.maximum(paint, 0), 0)), 0.0)
