"""Edge flips inside charts: the other diagonal of two neighbouring faces, where that evens the mesh out.

One-edge splits scatter degrees and edge lengths. A flip moves no vertex and no UV; it is carried out only where the
surface and the texture under it hardly change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exmesh_graph.geometry.adjacency import (
    Edges,
    area_vectors,
    edges_of,
    next_halfedge,
    signed_areas_2d,
    vertex_degrees,
)
from exmesh_graph.geometry.maps import VertexMap
from exmesh_graph.geometry.quality import degeneracy
from exmesh_graph.geometry.rounds import greedy_disjoint
from exmesh_graph.geometry.split import Topology


@dataclass(frozen=True)
class FlipSettings:
    """Which edges turn, and how much the surface and its texture may change.

    criterion   "delaunay": where the two angles opposite to the edge sum to more than half a turn;
                "valence": where the degrees of the four vertices come nearer to six (four on a boundary)
    max_bend    radians between the normals of the two faces, before and after
    max_shift   how far the texture may move where the diagonals cross, in lengths of the shorter diagonal's UVs
    min_shape   a new face must not be more degenerate (eq. 4) than this, unless the worse old one was
    """

    criterion: str = "delaunay"
    max_bend: float = 0.5
    max_shift: float = 0.1
    min_shape: float = 0.1


def flip(
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray,
    uv_faces: np.ndarray,
    settings: FlipSettings | None = None,
    *,
    max_rounds: int = 8,
) -> Topology:
    """Flip edges, round after round, while that evens the mesh out.

    vertices  float [V, 3]; faces int [F, 3]; uvs float [T, 2]; uv_faces int [F, 3]
    Vertices and UVs stay as they are; seams, boundaries and non-manifold edges are never flipped.
    """
    settings = settings or FlipSettings()
    state = Topology(vertices, faces, uvs, uv_faces, VertexMap(), np.arange(len(faces)), 0)
    for _ in range(max_rounds):
        halfedge = plan_flips(state, settings)
        if len(halfedge) == 0:
            break
        state = apply_flips(state, halfedge)
    return state


def plan_flips(state: Topology, settings: FlipSettings) -> np.ndarray:
    """One round: int64 [N], a half-edge of each edge to flip, in the order of the sequential pass.

    That pass takes edges by gain and skips one when another flip has changed the degree of one of its four vertices.
    """
    vertices, faces = state.vertices, state.faces
    edges = edges_of(faces)
    here, there, corner, uv_corner = _quads(state, edges)
    gain = _gain(vertices, faces, edges, corner, settings.criterion)
    able = np.flatnonzero(gain > 0)
    here, there, corner, uv_corner, gain = (x[able] for x in (here, there, corner, uv_corner, gain))
    a, b, c, d = corner.T
    degree = vertex_degrees(faces, len(vertices), edges)
    on_boundary = np.zeros(len(vertices), bool)
    on_boundary[edges.vertices[edges.count != 2].reshape(-1)] = True
    least = np.where(on_boundary, 2, 3)
    key = np.minimum(c, d) * len(vertices) + np.maximum(c, d)
    known = edges.vertices[:, 0] * len(vertices) + edges.vertices[:, 1]  # ascending
    exists = known[np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))] == key
    fair = (c != d) & ~exists & (degree[a] > least[a]) & (degree[b] > least[b])
    fair[fair] = _keeps_surface(vertices, corner[fair], settings)
    fair[fair] = _keeps_texture(vertices, state.uvs, corner[fair], uv_corner[fair], settings)

    here, corner, gain = here[fair], corner[fair], gain[fair]
    order = np.lexsort((here, -gain))
    n = len(order)
    touched = corner[order].reshape(-1)
    return here[order][greedy_disjoint(np.arange(n), 4 * np.arange(n + 1), touched, len(vertices))]


def apply_flips(state: Topology, halfedge: np.ndarray) -> Topology:
    """Carry out flips of disjoint pairs of faces: (a, b, c) and (b, a, d) become (a, d, c) and (d, b, c)."""
    faces, corners = state.faces.copy(), state.uv_faces.copy()
    sides = edges_of(state.faces)
    pair = sides.halfedges[sides.face_edges.reshape(-1)[halfedge]]
    there = np.where(pair[:, 0] == halfedge, pair[:, 1], pair[:, 0])
    for table in (faces, corners):
        a, b, c, d = _four(table, halfedge, there).T
        table[halfedge // 3] = np.stack([a, d, c], axis=1)
        table[there // 3] = np.stack([d, b, c], axis=1)
    return Topology(
        state.vertices, faces, state.uvs, corners, state.map, state.face_source, state.count + len(halfedge)
    )


def _quads(state: Topology, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Edges inside charts: (half-edge [N], its twin [N], vertices a, b, c, d [N, 4], their UVs [N, 4])."""
    here, there = edges.halfedges[edges.interior].T
    flat, uv_flat = state.faces.reshape(-1), state.uv_faces.reshape(-1)
    inside = (flat[here] == flat[next_halfedge(there)]) & (flat[there] == flat[next_halfedge(here)])
    inside &= (uv_flat[here] == uv_flat[next_halfedge(there)]) & (uv_flat[there] == uv_flat[next_halfedge(here)])
    here, there = here[inside], there[inside]
    return here, there, _four(state.faces, here, there), _four(state.uv_faces, here, there)


def _four(table: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """int64 [N, 4]: start a and end b of the half-edge, the corner c opposite to it and d opposite to its twin."""
    flat = table.reshape(-1)
    after = next_halfedge(here)
    return np.stack([flat[here], flat[after], flat[next_halfedge(after)], flat[next_halfedge(next_halfedge(there))]],
                    axis=1).astype(np.int64)  # fmt: skip


def _gain(vertices: np.ndarray, faces: np.ndarray, edges: Edges, corner: np.ndarray, criterion: str) -> np.ndarray:
    a, b, c, d = corner.T
    if criterion == "delaunay":
        angle = _angle(vertices, c, a, b) + _angle(vertices, d, a, b)
        other = _angle(vertices, a, c, d) + _angle(vertices, b, c, d)
        return np.round(np.minimum(angle - np.pi, angle - other), 6)
    on_boundary = np.zeros(len(vertices), bool)
    on_boundary[edges.vertices[edges.count != 2].reshape(-1)] = True
    excess = vertex_degrees(faces, len(vertices), edges) - np.where(on_boundary, 4, 6)
    return excess[a] + excess[b] - excess[c] - excess[d] - 2  # half the drop of the sum of squares


def _angle(vertices: np.ndarray, at: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    u, v = (vertices[x].astype(np.float64) - vertices[at] for x in (one, two))
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))


def _keeps_surface(vertices: np.ndarray, corner: np.ndarray, settings: FlipSettings) -> np.ndarray:
    """bool [N]: the four faces lie nearly in one plane, on the same side of it, and no sliver arises."""
    a, b, c, d = corner.T
    old = np.stack([a, b, c], axis=1), np.stack([b, a, d], axis=1)
    new = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
    fair = np.ones(len(corner), bool)
    for first, second in (old, new):
        n, m = area_vectors(vertices, first), area_vectors(vertices, second)
        size = np.linalg.norm(n, axis=1) * np.linalg.norm(m, axis=1)
        fair &= np.einsum("ij,ij->i", n, m) >= np.cos(settings.max_bend) * size
        fair &= size > 0
    course = area_vectors(vertices, old[0]) + area_vectors(vertices, old[1])
    shape = np.minimum(*(degeneracy(vertices, face) for face in old))
    for face in new:
        n = area_vectors(vertices, face)
        fair &= np.einsum("ij,ij->i", n, course) > 0
        fair &= degeneracy(vertices, face) >= np.minimum(shape, settings.min_shape) * (1.0 - 1e-5)
    return fair


def _keeps_texture(
    vertices: np.ndarray, uvs: np.ndarray, corner: np.ndarray, uv_corner: np.ndarray, settings: FlipSettings
) -> np.ndarray:
    """bool [N]: no new face folds over in the atlas, and the texture stays where it was at the crossing."""
    a, b, c, d = uv_corner.T
    fair = np.ones(len(corner), bool)
    whole = np.zeros(len(corner))
    for face in (np.stack([a, b, c], axis=1), np.stack([b, a, d], axis=1)):
        area = signed_areas_2d(uvs, face)
        fair &= area > 0
        whole += area
    for face in (np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)):
        fair &= signed_areas_2d(uvs, face) > 0.02 * whole
    s, t = _crossing(vertices, corner)
    p = [uvs[x].astype(np.float64) for x in (a, b, c, d)]
    shift = (1 - s)[:, None] * p[0] + s[:, None] * p[1] - (1 - t)[:, None] * p[2] - t[:, None] * p[3]
    shorter = np.minimum(np.linalg.norm(p[1] - p[0], axis=1), np.linalg.norm(p[3] - p[2], axis=1))
    return fair & (np.linalg.norm(shift, axis=1) <= settings.max_shift * shorter)


def _crossing(vertices: np.ndarray, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s [N], t [N]): a + s (b - a) and c + t (d - c), where the two diagonals come nearest to each other."""
    a, b, c, d = (vertices[corner[:, k]].astype(np.float64) for k in range(4))
    u, v, w = b - a, d - c, c - a
    uu, vv, uv = (np.einsum("ij,ij->i", x, y) for x, y in ((u, u), (v, v), (u, v)))
    uw, vw = np.einsum("ij,ij->i", u, w), np.einsum("ij,ij->i", v, w)
    det = uu * vv - uv * uv
    safe = np.where(det > 0, det, 1.0)
    return np.where(det > 0, (uw * vv - vw * uv) / safe, 0.5), np.where(det > 0, (uw * uv - vw * uu) / safe, 0.5)
