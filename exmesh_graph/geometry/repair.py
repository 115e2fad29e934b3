"""Making a triangle soup edge-manifold, vertex-manifold and consistently wound, and closing its small holes."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from exmesh_graph.geometry.adjacency import boundary_edges, corner_fans, face_areas
from exmesh_graph.types.edges import edges_of

Arrays = tuple[np.ndarray, np.ndarray]


def make_manifold(vertices: np.ndarray, faces: np.ndarray) -> Arrays:
    """Drop the smallest faces on edges with more than two, wind neighbours alike, double pinched vertices.

    A surface that cannot be oriented (a Moebius strip) keeps some disagreeing edges: measure the result.
    """
    faces = drop_crowding_faces(vertices, faces)
    faces = orient(faces)
    fans, vertex = corner_fans(faces)
    return vertices[vertex], fans.astype(np.int32)


def drop_crowding_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Of the faces on an edge with more than two, keep the two largest; again until no such edge is left."""
    while True:
        edges = edges_of(faces)
        crowded = edges.count > 2
        if not crowded.any():
            return faces
        owner = np.repeat(np.arange(len(faces)), 3)
        edge = edges.face_edges.reshape(-1)
        on = crowded[edge]
        owner, edge = owner[on], edge[on]
        order = np.lexsort((owner, -face_areas(vertices, faces)[owner], edge))
        owner, edge = owner[order], edge[order]
        rank = np.arange(len(edge)) - np.searchsorted(edge, edge)
        drop = np.zeros(len(faces), bool)
        drop[owner[rank >= 2]] = True
        faces = faces[~drop]


def orient(faces: np.ndarray) -> np.ndarray:
    """Turn faces so that neighbours run along their common edge in opposite directions.

    Every face has two states, kept and turned; states that agree across an edge are linked, and the linked set of the
    first face's kept state is taken in each connected part.
    """
    edges = edges_of(faces)
    here, there = edges.halfedges[edges.interior].T
    flat = faces.reshape(-1)
    alike = flat[here] != flat[there]
    left, right = here // 3, there // 3
    n = len(faces)
    rows = np.concatenate([left, left + n])
    columns = np.concatenate([np.where(alike, right, right + n), np.where(alike, right + n, right)])
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    _, label = connected_components(graph, directed=False)
    turned = label[:n] > label[n:]  # labels count up by first appearance, and kept states come first
    return np.where(turned[:, None], faces[:, ::-1], faces)


def fill_holes(vertices: np.ndarray, faces: np.ndarray, longest: int) -> Arrays:
    """Close boundary loops of at most `longest` edges by a fan around their mean. Needs a manifold mesh."""
    after = dict(boundary_edges(faces).tolist())
    points, fans = [vertices], [faces]
    count = len(vertices)
    while after:
        start = min(after)
        loop = [start]
        while (vertex := after.pop(loop[-1])) != start:
            loop.append(vertex)
        if len(loop) <= longest:
            points.append(vertices[loop].mean(0, keepdims=True))
            ends = np.roll(loop, -1)
            fans.append(np.stack([ends, loop, np.full(len(loop), count)], axis=1).astype(faces.dtype))
            count += 1
    return np.concatenate(points), np.concatenate(fans)
