"""Points spread over a mesh: every face carries a triangular lattice, shared along edges and at vertices.

With n steps per edge a face has (n + 1)(n + 2) / 2 lattice points of barycentric weights (n - i - j, i, j) / n,
numbered i = 0..n, j = 0..n - i. n = 1 is the plain mesh. Values stored at the points are interpolated linearly. Faces
may have steps of their own: where they meet they share what both have, so that an edge of 4 steps holds those of 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from exmesh_graph.geometry.adjacency import angle_weighted_normals, face_normals

_ALIKE = 1e-4
"""Cosines that differ by less count as equal when a point's carrying face is chosen."""


class Spread(Protocol):
    """What `locate` needs of a lattice: steps int32 [F], and face_points int32 [Q], the points of face after face."""

    @property
    def steps(self) -> np.ndarray: ...
    @property
    def face_points(self) -> np.ndarray: ...


@dataclass(frozen=True)
class Lattice:
    """The lattice points of a mesh.

    steps int32 [F], of each face's edges; face_points int32 [Q], the points of face after face (`face_starts`);
    points, normals float64 [P, 3]; point_face int32 [P]; point_bary float64 [P, 3]: the face that carries the point (of
    those that share it, the one that faces along the point's normal most; of those that do so alike, the first).
    """

    steps: np.ndarray
    face_points: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    point_face: np.ndarray
    point_bary: np.ndarray


def points_of_face(steps: np.ndarray) -> np.ndarray:
    """How many lattice points faces of so many `steps` per edge have."""
    return (steps + 1) * (steps + 2) // 2


def face_starts(steps: np.ndarray) -> np.ndarray:
    """Where each face's points begin in `face_points`, int64 [F]."""
    count = points_of_face(steps.astype(np.int64))
    return np.cumsum(count) - count


def build_lattice(vertices: np.ndarray, faces: np.ndarray, steps: int | np.ndarray) -> Lattice:
    """Spread the lattice of `steps` per edge, one number or one for each face [F], over the mesh."""
    faces = np.asarray(faces, np.int64)
    steps = np.broadcast_to(np.asarray(steps, np.int64), len(faces))
    identity, weights = _shared_identity(faces, len(vertices), steps)
    face_of = np.repeat(np.arange(len(faces)), points_of_face(steps))
    used, face_points = np.unique(identity, return_inverse=True)

    smooth = angle_weighted_normals(vertices, faces)
    flat = face_normals(vertices, faces)
    interpolated = np.einsum("qc,qcx->qx", weights, smooth[faces[face_of]])
    facing = np.einsum("qx,qx->q", interpolated, flat[face_of])
    most = np.full(len(used), -np.inf)
    np.maximum.at(most, face_points, facing)
    # ties are common (symmetric bodies); by their rounding errors they would be decided anew after every move
    alike = np.flatnonzero(facing >= most[face_points] - _ALIKE)
    first = np.full(len(used), facing.size)
    np.minimum.at(first, face_points[alike], alike)
    face, bary = face_of[first], weights[first]
    corners = np.asarray(vertices, np.float64)[faces[face]]
    normals = interpolated[first]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 1e-9, normals / np.maximum(length, 1e-9), flat[face])
    return Lattice(
        steps.astype(np.int32),
        face_points.astype(np.int32),
        np.einsum("pc,pcx->px", bary, corners),
        normals,
        face.astype(np.int32),
        bary,
    )


def lattice_weights(n: int) -> np.ndarray:
    """Integer barycentric weights (n - i - j, i, j) of the lattice points of a face, int64 [L, 3]."""
    return np.array([(n - i - j, i, j) for i in range(n + 1) for j in range(n + 1 - i)], np.int64)


def _shared_identity(faces: np.ndarray, vertex_count: int, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A number per lattice point of face after face, int64 [Q], equal exactly where faces share the point, and its
    barycentric weights [Q, 3]."""
    pairs = np.sort(np.stack([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]]], axis=-1), axis=-1)
    edges, edge_of = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1, 3)
    start = face_starts(steps)
    identity = np.empty(int(points_of_face(steps).sum()), np.int64)
    bary = np.empty((len(identity), 3))
    several = np.unique(steps)
    finest = math.lcm(*several.tolist())
    used = vertex_count + len(edges) * (finest - 1)
    for n in several.tolist():
        weights = lattice_weights(n)
        alike = np.flatnonzero(steps == n)
        inside = np.flatnonzero((weights > 0).all(axis=1))
        here, its_edges = faces[alike], edge_of[alike]
        for local, weight in enumerate(weights):
            place = start[alike] + local
            corners = np.flatnonzero(weight)
            if len(corners) == 1:
                identity[place] = here[:, corners[0]]
            elif len(corners) == 2:
                side = {(0, 1): 0, (1, 2): 1, (0, 2): 2}[(int(corners[0]), int(corners[1]))]
                first, second = here[:, corners[0]], here[:, corners[1]]
                # steps counted from the edge's smaller vertex, so that both faces agree
                step = np.where(first < second, weight[corners[1]], weight[corners[0]]) * (finest // n)
                identity[place] = vertex_count + its_edges[:, side] * (finest - 1) + step - 1
            else:
                rank = int(np.searchsorted(inside, local))
                identity[place] = used + np.arange(len(alike)) * len(inside) + rank
            bary[place] = weight / n
        used += len(alike) * len(inside)
    return identity, bary


def locate(lattice: Spread, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lattice points around surface positions and their linear weights: int32 [N, 3], float32 [N, 3].

    face [N] >= 0, bary [N, 3] summing to 1.
    """
    n = lattice.steps.astype(np.int64)[face]
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
    start = face_starts(lattice.steps)[face]
    points = lattice.face_points[start[:, None] + np.stack([a, b, c], axis=1)]
    return points.astype(np.int32), weight.astype(np.float32)


def _local(i: np.ndarray, j: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Number of lattice point (i, j) within its face."""
    return i * (n + 1) - i * (i - 1) // 2 + j
