"""The link condition: which edges may collapse without changing the topology."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import neighbours, next_halfedge
from exmesh_graph.geometry.rounds import ranges
from exmesh_graph.types.edges import Edges


def link_condition(faces: np.ndarray, edges: Edges, edge: np.ndarray, n_vertices: int) -> np.ndarray:
    """bool [N] for the edges `edge` int [N] of an edge-manifold mesh (Dey, Edelsbrunner, Guha, Nekhayev 1999).

    The ends have no common neighbour but the vertices opposite to the edge, and those have more than three neighbours
    (more than two on a boundary), else two faces would fall together.
    """
    start, near = neighbours(faces, n_vertices, edges)
    degree = np.diff(start)
    low, high = edges.vertices[edge].T
    few, many = np.where(degree[low] <= degree[high], (low, high), (high, low))
    size = degree[few]
    owner = np.repeat(np.arange(len(edge)), size)
    key = many[owner] * n_vertices + near[ranges(start[few], size)]
    known = np.repeat(np.arange(n_vertices), degree) * n_vertices + near  # ascending
    found = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
    common = np.bincount(owner, weights=known[found] == key, minlength=len(edge))

    sides = edges.halfedges[edge]
    on_boundary = np.zeros(n_vertices, bool)
    on_boundary[edges.vertices[edges.count == 1].reshape(-1)] = True
    opposite = faces.reshape(-1)[next_halfedge(next_halfedge(np.maximum(sides, 0)))]
    enough = (degree[opposite] > np.where(on_boundary[opposite], 2, 3)) | (sides < 0)
    return (common == edges.count[edge]) & enough.all(axis=1)
