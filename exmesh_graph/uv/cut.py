"""Any triangle soup made ready for charting: cut open where it is not a surface, less what has no place of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import corner_fans, face_normals
from exmesh_graph.types.edges import Edges, edges_of


@dataclass(frozen=True, eq=False)
class Sheets:
    """faces int64 [S, 3] over charting vertices, vertex int64 (the mesh's) of each of them; kept int64 [S], the face of
    the mesh that each is; twin int64 [F]: for a face that repeats another one, which; -1 for all others."""

    faces: np.ndarray
    vertex: np.ndarray
    kept: np.ndarray
    twin: np.ndarray


def defects(faces: np.ndarray) -> str:
    """What keeps `faces` from being a manifold surface, in words; empty for one that is."""
    edges = edges_of(faces)
    start = faces.reshape(-1)[edges.halfedges[edges.interior]]
    counts = {
        "edges with more than two faces": int((edges.count > 2).sum()),
        "edges between faces of opposite winding": int((start[:, 0] == start[:, 1]).sum()),
        "faces that use a vertex twice": int(_collapsed(faces).sum()),
    }
    return ", ".join(f"{count} {what}" for what, count in counts.items() if count)


def cut_open(points: np.ndarray, faces: np.ndarray, cut_nonmanifold: bool) -> Sheets:
    """Manifold sheets of a mesh; GeometryError for one that needs cuts unless `cut_nonmanifold`.

    At an edge with more than two faces the two that go on most smoothly stay together and the others are cut off.
    Faces that repeat another one, or use a vertex twice, are left out.
    """
    wrong = defects(faces)
    if wrong and not cut_nonmanifold:
        raise GeometryError(
            f"the mesh is not manifold: {wrong}",
            expected="an edge-manifold mesh of consistent winding",
            fix="clean the mesh first (init.clean), or set cut_nonmanifold",
        )
    twin = np.full(len(faces), -1, np.int64)
    if not wrong:
        fans, vertex = corner_fans(faces)
        return Sheets(fans, vertex, np.arange(len(faces)), twin)
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    _, first, again = np.unique(turned, axis=0, return_index=True, return_inverse=True)
    original = first[again.reshape(-1)]
    twin = np.where(original == np.arange(len(faces)), -1, original)
    kept = np.flatnonzero((twin < 0) & ~_collapsed(faces))
    fans, vertex = corner_fans(faces[kept], _paired(points, faces[kept]))
    return Sheets(fans, vertex, kept, twin)


def _collapsed(faces: np.ndarray) -> np.ndarray:
    return (faces == np.roll(faces, -1, axis=1)).any(axis=1)


def _paired(points: np.ndarray, faces: np.ndarray) -> Edges:
    """The edge table with at most one pair of faces left at every crowded edge: the smoothest of matching winding."""
    edges = edges_of(faces)
    crowded = np.flatnonzero(edges.count > 2)
    if len(crowded) == 0:
        return edges
    normals = face_normals(points, faces)
    start = faces.reshape(-1)
    of = edges.face_edges.reshape(-1)
    order = np.argsort(of, kind="stable")
    first = np.searchsorted(of[order], crowded)
    halfedges, count = edges.halfedges.copy(), edges.count.copy()
    for edge, at in zip(crowded.tolist(), first.tolist(), strict=True):
        halves = order[at : at + edges.count[edge]].tolist()
        pairs = [
            (-float(normals[i // 3] @ normals[j // 3]), i, j)
            for k, i in enumerate(halves)
            for j in halves[k + 1 :]
            if start[i] != start[j]
        ]
        if pairs:  # the others have no partner: their corners stay on their own side
            halfedges[edge] = min(pairs)[1:]
            count[edge] = 2
    return Edges(edges.vertices, halfedges, count, edges.face_edges)
