"""Points spread over a mesh: every face carries a triangular lattice, shared along edges and at vertices.

With subdivision n a face has (n + 1)(n + 2) / 2 lattice points of barycentric weights (n - i - j, i, j) / n, numbered
i = 0..n, j = 0..n - i. n = 1 is the plain mesh. Values stored at the points are interpolated linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exmesh_graph.geometry.adjacency import angle_weighted_normals, face_normals

_ALIKE = 1e-4
"""Cosines that differ by less count as equal when a point's carrying face is chosen."""


@dataclass(frozen=True)
class Lattice:
    """The lattice points of a mesh.

    face_points int32 [F, L]; points, normals float64 [P, 3]; point_face int32 [P]; point_bary float64 [P, 3]:
    the face that carries the point (of those that share it, the one that faces along the point's normal most; of those
    that do so alike, the first).
    """

    subdivision: int
    face_points: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    point_face: np.ndarray
    point_bary: np.ndarray


def build_lattice(vertices: np.ndarray, faces: np.ndarray, subdivision: int) -> Lattice:
    """Spread the lattice of `subdivision` steps per edge over the mesh."""
    n = subdivision
    faces = np.asarray(faces, np.int64)
    weights = lattice_weights(n)
    identity = _shared_identity(faces, len(vertices), weights, n)
    used, face_points = np.unique(identity, return_inverse=True)
    face_points = face_points.reshape(identity.shape)

    smooth = angle_weighted_normals(vertices, faces)
    flat = face_normals(vertices, faces)
    interpolated = np.einsum("lc,fcx->flx", weights / n, smooth[faces])
    facing = np.einsum("flx,fx->fl", interpolated, flat)
    flat_points, facing = face_points.reshape(-1), facing.reshape(-1)
    most = np.full(len(used), -np.inf)
    np.maximum.at(most, flat_points, facing)
    # ties are common (symmetric bodies); by their rounding errors they would be decided anew after every move
    alike = np.flatnonzero(facing >= most[flat_points] - _ALIKE)
    first = np.full(len(used), facing.size)
    np.minimum.at(first, flat_points[alike], alike)
    face, local = np.divmod(first, len(weights))
    bary = weights[local] / n
    corners = np.asarray(vertices, np.float64)[faces[face]]
    normals = interpolated.reshape(-1, 3)[first]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 1e-9, normals / np.maximum(length, 1e-9), flat[face])
    return Lattice(
        n,
        face_points.astype(np.int32),
        np.einsum("pc,pcx->px", bary, corners),
        normals,
        face.astype(np.int32),
        bary,
    )


def lattice_weights(n: int) -> np.ndarray:
    """Integer barycentric weights (n - i - j, i, j) of the lattice points of a face, int64 [L, 3]."""
    return np.array([(n - i - j, i, j) for i in range(n + 1) for j in range(n + 1 - i)], np.int64)


def _shared_identity(faces: np.ndarray, vertex_count: int, weights: np.ndarray, n: int) -> np.ndarray:
    """A number per (face, lattice point), int64 [F, L], equal exactly where faces share the point."""
    identity = np.empty((len(faces), len(weights)), np.int64)
    pairs = np.sort(np.stack([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]]], axis=-1), axis=-1)
    edges, edge_of = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1, 3)
    interior = vertex_count + len(edges) * (n - 1)
    inside = np.flatnonzero((weights > 0).all(axis=1))
    for local, weight in enumerate(weights):
        corners = np.flatnonzero(weight)
        if len(corners) == 1:
            identity[:, local] = faces[:, corners[0]]
        elif len(corners) == 2:
            side = {(0, 1): 0, (1, 2): 1, (0, 2): 2}[(int(corners[0]), int(corners[1]))]
            first, second = faces[:, corners[0]], faces[:, corners[1]]
            # steps counted from the edge's smaller vertex, so that both faces agree
            step = np.where(first < second, weight[corners[1]], weight[corners[0]])
            identity[:, local] = vertex_count + edge_of[:, side] * (n - 1) + step - 1
        else:
            rank = int(np.searchsorted(inside, local))
            identity[:, local] = interior + np.arange(len(faces)) * len(inside) + rank
    return identity


def locate(
    face_points: np.ndarray, subdivision: int, face: np.ndarray, bary: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lattice points around surface positions and their linear weights: int32 [N, 3], float32 [N, 3].

    face [N] >= 0, bary [N, 3] summing to 1.
    """
    n = subdivision
    x, y = np.clip(bary[:, 1], 0, 1) * n, np.clip(bary[:, 2], 0, 1) * n
    i = np.minimum(np.floor(x).astype(np.int64), n - 1)
    j = np.minimum(np.floor(y).astype(np.int64), n - 1 - i)
    fx, fy = x - i, y - j
    upper = (fx + fy > 1) & (i + j <= n - 2)
    # lower cell: (i, j), (i + 1, j), (i, j + 1); upper cell: (i + 1, j + 1), (i, j + 1), (i + 1, j)
    a = np.where(upper, _local(i + 1, j + 1, n), _local(i, j, n))
    b = np.where(upper, _local(i, j + 1, n), _local(i + 1, j, n))
    c = np.where(upper, _local(i + 1, j, n), _local(i, j + 1, n))
    weight = np.stack(
        [
            np.where(upper, fx + fy - 1, 1 - fx - fy),
            np.where(upper, 1 - fx, fx),
            np.where(upper, 1 - fy, fy),
        ],
        axis=1,
    )
    weight = np.clip(weight, 0, None)
    weight /= weight.sum(axis=1, keepdims=True)
    points = face_points[face[:, None], np.stack([a, b, c], axis=1)]
    return points.astype(np.int32), weight.astype(np.float32)


def _local(i: np.ndarray, j: np.ndarray, n: int) -> np.ndarray:
    """Number of lattice point (i, j) within its face."""
    return i * (n + 1) - i * (i - 1) // 2 + j
