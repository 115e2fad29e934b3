"""Charts laid flat, all at once: as-rigid-as-possible, so that areas and angles are kept as well as they can be.

Local/global (Liu, Zhang, Xu, Gotsman and Gortler 2008, "A Local/Global Approach to Mesh Parameterization"): every face
takes the rotation that fits it best, then one linear system joins the faces. Points are complex numbers u + i v.
"""

from __future__ import annotations

import numpy as np

_ROUNDS = 6
_LEAST, _MOST = 0.05, 20.0  # of a cotangent: negative ones would break the system, huge ones its condition


def flatten(corners: np.ndarray, faces: np.ndarray, count: int, start: np.ndarray, rounds: int = _ROUNDS) -> np.ndarray:
    """Lay charts flat; each keeps the sizes that it has in space.

    corners  complex [F, 3], every face laid flat by itself (`flat_corners`); area > 0
    faces    int [F, 3] over `count` chart vertices; charts share none
    start    complex [count], a first layout: unmirrored
    Returns complex [count]. Every chart keeps the place of one of its vertices.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import splu

    ahead = corners[:, [1, 2, 0]] - corners  # edge k runs from corner k to corner k + 1; corner k + 2 is opposite
    wings = -ahead[:, [2, 0, 1]] * np.conj(ahead[:, [1, 2, 0]])
    weight = np.clip(wings.real / np.maximum(np.abs(wings.imag), 1e-300), _LEAST, _MOST)
    tail, head = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    w = weight.reshape(-1)
    rows, columns = np.concatenate([tail, head, tail, head]), np.concatenate([head, tail, tail, head])
    matrix = coo_matrix((np.concatenate([-w, -w, w, w]), (rows, columns)), shape=(count, count)).tocsc()
    label = connected_components(matrix, directed=False)[1]
    held = np.unique(label, return_index=True)[1]
    free = np.ones(count, bool)
    free[held] = False
    factor = splu(
        matrix[free][:, free], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    pull = matrix[free][:, held]
    flat = start.astype(np.complex128)
    for _ in range(rounds):
        now = flat[faces[:, [1, 2, 0]]] - flat[faces]
        fit = (weight * np.conj(ahead) * now).sum(axis=1)
        size = np.abs(fit)
        turn = np.where(size > 0, fit / np.where(size > 0, size, 1.0), 1.0)
        wish = (weight * ahead * turn[:, None]).reshape(-1)
        right = _sum(head, wish, count) - _sum(tail, wish, count)
        right = right[free] - pull @ flat[held]
        solved = factor.solve(np.stack([right.real, right.imag], axis=1))
        flat[free] = solved[:, 0] + 1j * solved[:, 1]
    return flat


def flat_corners(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """complex128 [F, 3]: every face of `points` [V, 3] laid flat, corner 0 at 0, corner 1 on the real axis."""
    a, b, c = (points[faces[:, k]].astype(np.float64) for k in range(3))
    along = np.linalg.norm(b - a, axis=1)
    safe = np.where(along > 0, along, 1.0)
    x = np.einsum("ij,ij->i", c - a, b - a) / safe
    y = np.linalg.norm(np.cross(b - a, c - a), axis=1) / safe
    return np.stack([np.zeros(len(faces), np.complex128), along + 0j, x + 1j * y], axis=1)


def _sum(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    return np.bincount(index, values.real, count) + 1j * np.bincount(index, values.imag, count)


def stretches(corners: np.ndarray, faces: np.ndarray, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(lesser, greater) factor [F] by which each face's lengths change; the lesser is negative for a mirrored face.

    corners as in `flatten`; flat complex [T]. A face without area gives (0, 0).
    """
    p, q = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    u, v = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    twice = p * np.conj(q) - q * np.conj(p)
    safe = np.where(twice == 0, 1.0, twice)
    along = np.where(twice == 0, 0.0, np.abs((u * np.conj(q) - v * np.conj(p)) / safe))
    against = np.where(twice == 0, 0.0, np.abs((v * p - u * q) / safe))
    return along - against, along + against
