"""The edge table of a triangle mesh, and what a mesh on a wire promises by it: manifold, closed.

Half-edge h = 3 f + k runs from corner k to corner (k + 1) % 3 of face f; the corner opposite to it is (k + 2) % 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Edges:
    """The undirected edges of a triangle mesh, sorted by (lower vertex, higher vertex).

    vertices    int64 [E, 2], lower index first
    halfedges   int64 [E, 2], the first two half-edges on the edge in ascending order; -1 where there is none
    count       int64 [E], how many half-edges lie on the edge: 1 boundary, 2 interior, more: non-manifold
    face_edges  int64 [F, 3], the edge of half-edge 3 f + k
    """

    vertices: np.ndarray
    halfedges: np.ndarray
    count: np.ndarray
    face_edges: np.ndarray

    def __len__(self) -> int:
        return len(self.vertices)

    @property
    def faces(self) -> np.ndarray:
        """int64 [E, 2], the faces on each side; -1 where there is none."""
        return np.where(self.halfedges >= 0, self.halfedges // 3, -1)

    @property
    def interior(self) -> np.ndarray:
        """bool [E], edges with exactly two faces."""
        return self.count == 2


def edges_of(faces: np.ndarray) -> Edges:
    """The edge table of `faces` (int [F, 3])."""
    start = faces.astype(np.int64, copy=False).reshape(-1)
    end = np.roll(faces.astype(np.int64, copy=False), -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    stride = int(high.max()) + 1 if len(high) else 1
    order = counting_argsort(high, stride)
    order = order[counting_argsort(low[order], stride)]
    sorted_key = (low * stride + high)[order]
    first = np.flatnonzero(np.r_[True, sorted_key[1:] != sorted_key[:-1]]) if len(low) else np.zeros(0, np.int64)
    count = np.diff(np.r_[first, len(low)])
    edge_of_sorted = np.repeat(np.arange(len(first)), count)
    face_edges = np.empty(len(low), np.int64)
    face_edges[order] = edge_of_sorted
    second = np.where(count >= 2, order[np.minimum(first + 1, len(low) - 1)], -1) if len(low) else first
    lead = order[first]
    return Edges(
        vertices=np.stack([low[lead], high[lead]], axis=1),
        halfedges=np.stack([lead, second], axis=1),
        count=count,
        face_edges=face_edges.reshape(-1, 3),
    )


def counting_argsort(keys: np.ndarray, n: int) -> np.ndarray:
    """int64 [N], the stable order of integer keys in [0, n): linear in N, half the time of sorting them.

    A sparse matrix with one entry per row, at the column of its key: by columns, its rows come in that order.
    """
    from scipy.sparse import csr_matrix

    rows = np.arange(len(keys) + 1, dtype=np.int32)
    table = csr_matrix((np.ones(len(keys), np.int8), keys.astype(np.int32), rows), shape=(len(keys), n))
    return table.tocsc().indices.astype(np.int64)


def is_edge_manifold(faces: np.ndarray) -> bool:
    """Whether no edge has more than two faces and no face uses a vertex twice."""
    return bool((edges_of(faces).count <= 2).all()) and not has_collapsed_faces(faces)


def is_closed(faces: np.ndarray) -> bool:
    """Whether every edge has exactly two faces."""
    return bool((edges_of(faces).count == 2).all()) and not has_collapsed_faces(faces)


def has_collapsed_faces(faces: np.ndarray) -> bool:
    """Whether some face names the same vertex twice."""
    return bool(((faces == np.roll(faces, -1, axis=1)).any(axis=1)).any())
