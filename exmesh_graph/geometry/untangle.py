"""Faces that cut one another: found, and smoothed apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exmesh_graph.geometry.settings import UntangleSettings
from exmesh_graph.geometry.topology import ranges
from exmesh_graph.types.edges import edges_of

_CELL = 1.5  # cells are this many times as wide as the median face
_STRENGTH = 0.5
_RINGS = 3  # the patch that moves grows up to so many rings around the cut


class Untangled(NamedTuple):
    """vertices [V, 3] as they went in; before, after: faces that cut others; moved: vertices in another place."""

    vertices: np.ndarray
    before: int
    after: int
    moved: int


def untangle(vertices: np.ndarray, faces: np.ndarray, settings: UntangleSettings | None = None) -> Untangled:
    """Smooth the vertices of faces that cut others, and of what lies around them, until no face does.

    A step moves each of these vertices half the way to the mean of its neighbours. The patch is the cutting
    faces at first and grows by a ring after every third of the steps. Vertices on a boundary stay. Of all steps the one
    with the fewest cutting faces is kept, the first of equals: nothing moves where smoothing does not help.
    """
    steps = (settings or UntangleSettings()).steps
    edges = edges_of(faces)
    low, high = edges.vertices.T
    count = len(vertices)
    degree = np.maximum(np.bincount(edges.vertices.reshape(-1), minlength=count), 1)
    fixed = np.zeros(count, bool)
    fixed[edges.vertices[edges.count != 2].reshape(-1)] = True
    points = vertices.astype(np.float64)
    cutting = np.unique(cutting_pairs(points, faces))
    before = len(cutting)
    best, fewest = points, before
    patch = np.zeros(count, bool)
    for step in range(steps):
        if len(cutting) == 0:
            break
        patch[faces[cutting]] = True
        for _ in range(_RINGS * step // steps):
            grown = patch.copy()
            grown[low[patch[high]]] = True
            grown[high[patch[low]]] = True
            patch = grown
        free = patch & ~fixed
        mean = np.stack([
            np.bincount(np.concatenate([low, high]), np.concatenate([points[high, k], points[low, k]]), count)
            for k in range(3)
        ], axis=1) / degree[:, None]  # fmt: skip
        points = np.where(free[:, None], points + _STRENGTH * (mean - points), points)
        cutting = np.unique(cutting_pairs(points, faces))
        if len(cutting) < fewest:
            best, fewest = points, len(cutting)
        patch[:] = False
    placed = best.astype(vertices.dtype)
    return Untangled(placed, before, fewest, int((placed != vertices).any(axis=1).sum()))


def cutting_pairs(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """int64 [P, 2], pairs of faces (the lower index first, in order) of which one's edge crosses the other's inside.

    Faces that touch, share an edge, or lie in one plane do not cut each other.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    pairs = _close_pairs(corners)
    one, other = pairs.T
    crossed = np.zeros(len(pairs), bool)
    for k in range(3):
        for a, b in ((one, other), (other, one)):
            start, end = faces[a, k], faces[a, (k + 1) % 3]
            own = (faces[b] == start[:, None]).any(axis=1) | (faces[b] == end[:, None]).any(axis=1)
            ask = np.flatnonzero(~own & ~crossed)
            crossed[ask] = _crosses(corners[a[ask], k], corners[a[ask], (k + 1) % 3], corners[b[ask]])
    return pairs[crossed]


def _close_pairs(corners: np.ndarray) -> np.ndarray:
    """int64 [P, 2], faces whose bounding boxes overlap: found in a grid of cells in which each face stands wherever its
    box reaches."""
    if len(corners) == 0:
        return np.zeros((0, 2), np.int64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    extent = (high - low).max(axis=1)
    # no face may fill the table: a mesh with a few huge faces gets coarser cells
    size = max(_CELL * float(np.median(extent)), float(extent.max()) / 64, 1e-300)
    first = np.floor((low - low.min(axis=0)) / size).astype(np.int64)
    span = np.floor((high - low.min(axis=0)) / size).astype(np.int64) - first + 1
    number = span.prod(axis=1)
    face = np.repeat(np.arange(len(corners)), number)
    k = ranges(np.zeros(len(corners), np.int64), number)
    x, rest = k % span[face, 0], k // span[face, 0]
    cell = first[face] + np.stack([x, rest % span[face, 1], rest // span[face, 1]], axis=1)
    shape = cell.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    key, face = key[order], face[order]
    begin = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    end = np.r_[begin[1:], len(key)]
    place = np.arange(len(key))
    after = np.repeat(end, end - begin) - place - 1  # those that follow in the same cell
    pairs = np.stack([face[np.repeat(place, after)], face[ranges(place + 1, after)]], axis=1)
    a, b = pairs.T
    pairs = pairs[((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)]
    key = np.unique(pairs.min(axis=1) * len(corners) + pairs.max(axis=1))
    return np.stack([key // len(corners), key % len(corners)], axis=1)


def _crosses(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """bool [N], segments [N, 3] to [N, 3] that pass through the inside of triangles [N, 3, 3]: signs of volumes."""

    def volume(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)

    a, b, c = triangle.transpose(1, 0, 2)
    across = volume(a, b, c, start) * volume(a, b, c, end) < 0
    u, v, w = (volume(start, end, p, q) for p, q in ((a, b), (b, c), (c, a)))
    return across & (((u > 0) & (v > 0) & (w > 0)) | ((u < 0) & (v < 0) & (w < 0)))
