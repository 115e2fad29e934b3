"""Small connected patches of a mesh, of which charts are put together: grown from even seeds, cut where they bend."""

from __future__ import annotations

import numpy as np

_PATCHES = 1500
_LLOYD = 2  # times that seeds move to the middle of their patch
_CREASE = 4.0  # how much farther it is across a right angle, for growing patches
_SMOOTHING = 6  # rounds: single normals of a noisy surface say nothing
_ALIKE = 0.6  # length of a mean of normals, of which more are taken
_CUTS = 6  # of a patch that bends, at most


def smooth_normals(vectors: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Unit normals [F, 3], each a mean over the faces around.

    Means over faces of a similar direction only would keep creases to the face, but fail on a rough surface: 117 charts
    in place of 14 on a sphere of 5 120 faces with noise of 0.3 edge lengths. Where faces around look all ways, on a rod
    or a leaf a few faces wide, a mean over fewer of them stays.
    """
    from scipy.sparse import csr_matrix

    n = len(vectors)
    pairs = (np.concatenate([here, there]), np.concatenate([there, here]))
    beside = csr_matrix((np.full(2 * len(here), 1.0 / 6.0), pairs), shape=(n, n))
    area = np.linalg.norm(vectors, axis=1)
    mean = vectors
    for _ in range(_SMOOTHING):
        vectors, area = 0.5 * vectors + beside @ vectors, 0.5 * area + beside @ area
        alike = np.linalg.norm(vectors, axis=1) > _ALIKE * area
        mean = np.where(alike[:, None], vectors, mean)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    return mean / np.where(length > 0, length, 1.0)


def small_patches(
    centres: np.ndarray, normals: np.ndarray, area: np.ndarray, here: np.ndarray, there: np.ndarray, bend: float
) -> np.ndarray:
    """int64 [F]: about `_PATCHES` connected patches, more where a patch would bend more than a chart may.

    centres, normals  float [F, 3]; area [F]; here, there  int [E], the two faces of every inner edge
    bend              bound of 1 - |mean normal|^2 in a patch
    """
    return _unbent(_patches(centres, normals, area, here, there), normals, area, here, there, bend)


def _patches(
    centres: np.ndarray, normals: np.ndarray, area: np.ndarray, here: np.ndarray, there: np.ndarray
) -> np.ndarray:
    """int64 [F]: about `_PATCHES` connected patches, each the faces nearest to its seed along the surface."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components, dijkstra

    n = len(centres)
    turn = 1.0 - np.einsum("ij,ij->i", normals[here], normals[there])
    step = (np.linalg.norm(centres[here] - centres[there], axis=1) + 1e-9) * (1.0 + _CREASE * turn)
    graph = csr_matrix(
        (np.concatenate([step, step]), (np.concatenate([here, there]), np.concatenate([there, here]))), shape=(n, n)
    )
    order = np.argsort(_morton(centres), kind="stable")
    every = max(1, n // _PATCHES)
    # one seed for each piece of the mesh, however small it is
    _, piece = connected_components(graph, directed=False)
    firsts = order[np.unique(piece[order], return_index=True)[1]]
    seeds = np.union1d(order[every // 2 :: every], firsts)
    for turn_left in range(_LLOYD, -1, -1):
        source = dijkstra(graph, indices=seeds, min_only=True, return_predecessors=True)[2]
        patch = np.searchsorted(seeds, source)
        if turn_left:
            share = np.bincount(patch, area) + 1e-300
            middle = np.stack([np.bincount(patch, area * centres[:, k]) for k in range(3)], axis=1) / share[:, None]
            away = np.linalg.norm(centres - middle[patch], axis=1)
            nearest = np.lexsort((away, patch))
            seeds = np.sort(nearest[np.r_[True, np.diff(patch[nearest]) > 0]])
    return patch


def _unbent(
    patch: np.ndarray, normals: np.ndarray, area: np.ndarray, here: np.ndarray, there: np.ndarray, bend: float
) -> np.ndarray:
    """int64 [F]: the patches, those that bend more than a chart may (around a rod, over the edge of a leaf) cut by the
    direction that their faces look in."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    for _ in range(_CUTS):
        count = int(patch.max()) + 1
        total = np.bincount(patch, area, count) + 1e-300
        mean = np.stack([np.bincount(patch, area * normals[:, k], count) for k in range(3)], axis=1) / total[:, None]
        bent = 1.0 - (mean**2).sum(axis=1) > bend
        mine = np.flatnonzero(bent[patch] & (np.bincount(patch, minlength=count) > 1)[patch])
        if len(mine) == 0:
            break
        owner = patch[mine]
        away = normals[mine] - mean[owner]
        spread = np.zeros((count, 3, 3))
        np.add.at(spread, owner, area[mine, None, None] * away[:, :, None] * away[:, None, :])
        axis = np.linalg.eigh(spread)[1][:, :, 2]
        side = np.zeros(len(patch), np.int64)
        side[mine] = (away * axis[owner]).sum(axis=1) > 0
        part = 2 * patch + side
        joined = part[here] == part[there]
        graph = csr_matrix((np.ones(int(joined.sum())), (here[joined], there[joined])), shape=(len(patch), len(patch)))
        patch = connected_components(graph, directed=False)[1].astype(np.int64)
    return patch


def _morton(points: np.ndarray) -> np.ndarray:
    """Position along a curve that fills the points' box: neighbours on it are neighbours in space."""
    extent = np.ptp(points, axis=0).max()
    cell = ((points - points.min(axis=0)) / (extent if extent > 0 else 1.0) * 1023.0).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
