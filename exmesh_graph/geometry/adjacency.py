"""Who is next to whom in a triangle mesh: every question answered from its edge table (`types.edges`).

Everything is vectorised; nothing assumes that the mesh is manifold unless it says so.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.types.edges import Edges, counting_argsort, edges_of


def require_mesh(vertices: np.ndarray, faces: np.ndarray, where: str) -> None:
    """Raise DataError unless these are arrays float [V, 3] and int [F, 3], all indices within V."""
    for name, array, kind, number in (("vertices", vertices, "f", np.float32), ("faces", faces, "iu", np.int32)):
        if isinstance(array, np.ndarray) and array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind in kind:
            continue
        told = f"{array.dtype} {list(array.shape)}" if hasattr(array, "dtype") else f"a {type(array).__name__}"
        fix = f"np.asarray({name}, np.{number.__name__})" if np.shape(array)[1:] == (3,) else ""
        expected = f"a numpy array {'float' if kind == 'f' else 'int'} [{name[0].upper()}, 3]"
        raise DataError(f"{name}: {told}", where=where, expected=expected, fix=fix)
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise DataError(f"faces hold indices from {faces.min()} to {faces.max()}", where=where,
                        expected=f"0 to {len(vertices) - 1}, one for each vertex")  # fmt: skip


def corner_fans(
    faces: np.ndarray, edges: Edges | None = None, keep: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Groups the corners that reach each other around a vertex across interior edges of consistent winding.

    keep  bool [E], edges that may be crossed (all if None): leave edges out to cut the mesh along them.
    Returns fans int64 [F, 3] (group of each corner, numbered by first appearance) and vertex int64 [groups].
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = edges_of(faces) if edges is None else edges
    use = edges.interior if keep is None else edges.interior & keep
    flat = faces.reshape(-1)
    here, there = edges.halfedges[use].T
    opposed = flat[here] != flat[there]
    here, there = here[opposed], there[opposed]
    after_here, after_there = next_halfedge(here), next_halfedge(there)
    rows = np.concatenate([here, after_here])  # the corner at the start of one is the corner at the end of the other
    columns = np.concatenate([after_there, there])
    n = flat.size
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    rank, first = _by_appearance(label)
    return rank.reshape(faces.shape), flat[first].astype(np.int64)


def next_halfedge(h: np.ndarray) -> np.ndarray:
    """The half-edge after `h` in its face."""
    return h - h % 3 + (h + 1) % 3


def opposite_halfedges(edges: Edges) -> np.ndarray:
    """int64 [3 F], the other half-edge of each half-edge's edge; -1 on a boundary and on non-manifold edges."""
    first, second = edges.halfedges.T
    partner = np.full(edges.face_edges.size, -1, np.int64)
    partner[first[edges.interior]] = second[edges.interior]
    partner[second[edges.interior]] = first[edges.interior]
    return partner


def boundary_edges(faces: np.ndarray, edges: Edges | None = None) -> np.ndarray:
    """int64 [B, 2], the directed half-edges (start, end) that have no partner."""
    edges = edges_of(faces) if edges is None else edges
    h = edges.halfedges[edges.count == 1, 0]
    flat = faces.reshape(-1)
    return np.stack([flat[h], flat[next_halfedge(h)]], axis=1).astype(np.int64)


def vertex_degrees(faces: np.ndarray, n_vertices: int, edges: Edges | None = None) -> np.ndarray:
    """int64 [V], the number of edges at each vertex."""
    edges = edges_of(faces) if edges is None else edges
    return np.bincount(edges.vertices.reshape(-1), minlength=n_vertices)


def neighbours(faces: np.ndarray, n_vertices: int, edges: Edges | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(offsets int64 [V + 1], indices): the neighbours of v, ascending, are indices[offsets[v]:offsets[v + 1]]."""
    edges = edges_of(faces) if edges is None else edges
    low, high = edges.vertices.T
    start, end = np.concatenate([high, low]), np.concatenate([low, high])
    order = counting_argsort(start, n_vertices)  # the edge table is sorted: lower neighbours, then higher, ascending
    offsets = np.concatenate([[0], np.cumsum(np.bincount(start, minlength=n_vertices))])
    return offsets, end[order]


def incident_faces(faces: np.ndarray, n_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """(offsets int64 [V + 1], indices): the faces at v, ascending, are indices[offsets[v]:offsets[v + 1]]."""
    flat = faces.reshape(-1)
    offsets = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=n_vertices))])
    return offsets, counting_argsort(flat, n_vertices) // 3


def compact(index: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(the numbers below `n` that `index` uses, ascending int64 [K]; `index` in terms of their places, int64)."""
    used = np.zeros(n, bool)
    used[index] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[index]


def without_unused(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points [P, D] and faces without the points that no face uses; order and dtypes stay, none are joined."""
    used, index = compact(faces, len(points))
    return points[used], index.astype(faces.dtype)


def euler_characteristic(faces: np.ndarray) -> int:
    """V - E + F over the vertices that faces use: 2 for a sphere, 0 for a torus, 1 for a disc."""
    return len(np.unique(faces)) - len(edges_of(faces)) + len(faces)


def components(faces: np.ndarray, edges: Edges | None = None, keep: np.ndarray | None = None) -> np.ndarray:
    """int64 [F], the edge-connected component of every face, numbered by first appearance.

    keep  bool [E], edges that connect (all if None).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = edges_of(faces) if edges is None else edges
    # Every face against the first face of its edge: right for non-manifold edges too.
    lead = edges.halfedges[edges.face_edges.reshape(-1), 0] // 3
    face = np.repeat(np.arange(len(faces)), 3)
    if keep is not None:
        crossing = keep[edges.face_edges.reshape(-1)]
        lead, face = lead[crossing], face[crossing]
    graph = coo_matrix((np.ones(len(face), np.int8), (face, lead)), shape=(len(faces), len(faces)))
    _, label = connected_components(graph, directed=False)
    return _by_appearance(label)[0]


def lengths(vectors: np.ndarray) -> np.ndarray:
    """The lengths [N] of vectors [N, D]."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Cross products [N, 3]: the same numbers as numpy's, which takes twice as long on rows of three."""
    out = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = u[:, j] * v[:, k] - u[:, k] * v[:, j]
    return out


def area_vectors(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F, 3], the face normals times twice the face areas."""
    points = vertices.astype(np.float64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    return cross(b - a, c - a)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F]."""
    return 0.5 * lengths(area_vectors(vertices, faces))


def signed_areas_2d(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F], areas of triangles over `points` [T, 2]; positive when counter-clockwise with v up."""
    a, b, c = (points[faces[:, k]].astype(np.float64) for k in range(3))
    return 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]))


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F, 3], unit normals; zero for faces without area."""
    vectors = area_vectors(vertices, faces)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def area_weighted_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [V, 3], unit normals at the vertices, faces weighted by area: the direction of the volume's gradient,
    which is what moving a vertex along the surface needs. Zero for unused vertices."""
    vectors = area_vectors(vertices, faces)
    total = np.stack(
        [
            np.bincount(faces.reshape(-1), weights=np.repeat(vectors[:, k], 3), minlength=len(vertices))
            for k in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def angle_weighted_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [V, 3], unit normals at the vertices, faces weighted by the corner's angle: what shading uses.

    (Thuermer and Wuethrich 1998: independent of how a flat region is triangulated.) Zero where no face has area.
    """
    points = np.asarray(vertices, np.float64)
    normals = face_normals(vertices, faces)
    total = np.zeros_like(points)
    for corner in range(3):
        origin = points[faces[:, corner]]
        one = points[faces[:, (corner + 1) % 3]] - origin
        two = points[faces[:, (corner + 2) % 3]] - origin
        angle = np.arctan2(np.linalg.norm(np.cross(one, two), axis=1), (one * two).sum(axis=1))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, corner], weights=normals[:, axis] * angle, minlength=len(points))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 1e-12)


def edge_lengths(vertices: np.ndarray, edges: Edges) -> np.ndarray:
    """float64 [E]."""
    ends = vertices[edges.vertices].astype(np.float64)
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by a closed mesh; positive when its faces run counter-clockwise seen from outside."""
    centred = vertices.astype(np.float64) - vertices[faces.reshape(-1)].astype(np.float64).mean(axis=0)
    a, b, c = (centred[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def _by_appearance(label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(labels 0 .. n - 1 numbered anew by first appearance int64 [N], where each first appears int64 [n])."""
    first = np.empty(int(label.max(initial=-1)) + 1, np.int64)
    first[label[::-1]] = np.arange(len(label))[::-1]
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(first), np.int64)
    rank[order] = np.arange(len(first))
    return rank[label], first[order]
