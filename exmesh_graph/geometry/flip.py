"""Edge flips inside charts: the other diagonal of two neighbouring faces, where that evens the mesh out.

One-edge splits scatter degrees and edge lengths. A flip moves no vertex and no UV; it is carried out only where the
surface and the texture under it hardly change.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import (
    area_vectors,
    cross,
    next_halfedge,
    opposite_halfedges,
    signed_areas_2d,
    vertex_degrees,
)
from exmesh_graph.geometry.settings import FlipSettings
from exmesh_graph.geometry.topology import Topology, VertexMap, degeneracy, greedy_disjoint
from exmesh_graph.types.edges import edges_of


def flip(
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray,
    uv_faces: np.ndarray,
    settings: FlipSettings | None = None,
) -> Topology:
    """Flip edges, round after round, while that evens the mesh out.

    vertices  float [V, 3]; faces int [F, 3]; uvs float [T, 2]; uv_faces int [F, 3]
    Vertices and UVs stay as they are; seams, boundaries and non-manifold edges are never flipped. A round is a pass
    over the edges by gain, which skips one when a flip has changed the degree of one of its four vertices.
    """
    settings = settings or FlipSettings()
    work = _Work(vertices, faces, uvs, uv_faces, settings)
    candidates = np.flatnonzero(np.arange(faces.size) < work.partner)
    count = 0
    for _ in range(settings.max_rounds):
        chosen = work.plan(candidates)
        if len(chosen) == 0:
            break
        candidates = work.carry_out(chosen)
        count += len(chosen)
    return Topology(vertices, work.faces, uvs, work.corners, VertexMap(), np.arange(len(faces)), count)


class _Work:
    """A mesh that changes by flips, with the half-edges' partners and the degrees kept up to date."""

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray, settings: FlipSettings
    ) -> None:
        edges = edges_of(faces)
        self.vertices, self.uvs, self.settings = vertices.astype(np.float64), uvs.astype(np.float64), settings
        self.faces, self.corners = faces.copy(), uv_faces.copy()
        self.partner = opposite_halfedges(edges)
        self.degree = vertex_degrees(faces, len(vertices), edges)
        self.on_boundary = np.zeros(len(vertices), bool)
        self.on_boundary[edges.vertices[edges.count != 2].reshape(-1)] = True

    def plan(self, halfedge: np.ndarray) -> np.ndarray:
        """Those of the half-edges int64 [N] that one round flips, in its order."""
        there = self.partner[halfedge]
        quad, uv_quad = _four(self.faces, halfedge, there), _four(self.corners, halfedge, there)
        flat, uv_flat = self.faces.reshape(-1), self.corners.reshape(-1)
        gain = self._gain(quad)
        fair = (gain > 0) & (quad[:, 2] != quad[:, 3])
        for table, four in ((flat, quad), (uv_flat, uv_quad)):  # the twin runs back along it, in the same chart
            fair &= (table[there] == four[:, 1]) & (table[next_halfedge(there)] == four[:, 0])
        fair &= (self.degree[quad[:, :2]] > np.where(self.on_boundary[quad[:, :2]], 2, 3)).all(axis=1)
        fair[fair] = _keeps_surface(self.vertices, quad[fair], self.settings)
        fair[fair] = _keeps_texture(self.vertices, self.uvs, quad[fair], uv_quad[fair], self.settings)
        fair[fair] = ~self._joined(quad[fair, 2], quad[fair, 3])
        halfedge, quad, gain = halfedge[fair], quad[fair], gain[fair]
        order = np.lexsort((halfedge, -gain))
        n = len(order)
        go = greedy_disjoint(np.arange(n), 4 * np.arange(n + 1), quad[order].reshape(-1), len(self.vertices))
        return halfedge[order][go]

    def carry_out(self, here: np.ndarray) -> np.ndarray:
        """(a, b, c) and (b, a, d) become (a, d, c) and (d, b, c). Returns the half-edges worth judging again."""
        there = self.partner[here]
        sides = (next_halfedge(next_halfedge(here)), next_halfedge(here), next_halfedge(there),
                 next_halfedge(next_halfedge(there)))  # fmt: skip
        ca, bc, ad, db = (self.partner[side] for side in sides)
        quad = _four(self.faces, here, there)
        for table in (self.faces, self.corners):
            a, b, c, d = _four(table, here, there).T
            table[here // 3], table[there // 3] = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
        f, g = here - here % 3, there - there % 3
        for new, other in ((f, ad), (f + 1, g + 2), (f + 2, ca), (g, db), (g + 1, bc), (g + 2, f + 1)):
            self.partner[new] = other
            self.partner[other[other >= 0]] = new[other >= 0]
        np.subtract.at(self.degree, quad[:, :2], 1)
        np.add.at(self.degree, quad[:, 2:], 1)
        changed = np.zeros(len(self.vertices), bool)
        changed[quad] = True
        near = (3 * np.flatnonzero(changed[self.faces].any(axis=1))[:, None] + np.arange(3)).reshape(-1)
        again = np.zeros(self.faces.size, bool)
        again[np.minimum(near, self.partner[near])[self.partner[near] >= 0]] = True
        return np.flatnonzero(again)

    def _gain(self, quad: np.ndarray) -> np.ndarray:
        a, b, c, d = quad.T
        if self.settings.method == "valence":
            excess = self.degree - np.where(self.on_boundary, 4, 6)
            return excess[a] + excess[b] - excess[c] - excess[d] - 2  # half the drop of the sum of squares
        # sin(c + d) < 0 when the angles opposite to the edge exceed half a turn: cheap, and most edges end here
        cos_c, sin_c = _angle_parts(self.vertices, c, a, b)
        cos_d, sin_d = _angle_parts(self.vertices, d, a, b)
        gain = np.zeros(len(quad))
        wide = np.flatnonzero(sin_c * cos_d + cos_c * sin_d < 0)
        angle = np.arctan2(sin_c, cos_c)[wide] + np.arctan2(sin_d, cos_d)[wide]
        other = sum(np.arctan2(*_angle_parts(self.vertices, x[wide], c[wide], d[wide])[::-1]) for x in (a, b))
        gain[wide] = np.round(np.minimum(angle - np.pi, angle - other), 6)
        return gain

    def _joined(self, c: np.ndarray, d: np.ndarray) -> np.ndarray:
        """bool [N], whether an edge joins c and d."""
        n = len(self.vertices)
        asked = np.zeros(n, bool)
        asked[c] = True
        face, k = np.nonzero(asked[self.faces])
        start = self.faces[face, k].astype(np.int64) * n
        known = np.concatenate([start + self.faces[face, (k + turn) % 3] for turn in (1, 2)])
        return np.isin(c * n + d, known)


def _four(table: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """int64 [N, 4]: start a and end b of the half-edge, the corner c opposite to it and d opposite to its twin."""
    flat = table.reshape(-1)
    after = next_halfedge(here)
    last = next_halfedge(next_halfedge(there))
    return np.stack([flat[here], flat[after], flat[next_halfedge(after)], flat[last]], axis=1).astype(np.int64)


def _angle_parts(points: np.ndarray, at: np.ndarray, one: np.ndarray, two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(cosine, sine) of the angle at `at` between `one` and `two`, times the product of the sides."""
    origin = points[at]
    u, v = points[one] - origin, points[two] - origin
    return np.einsum("ij,ij->i", u, v), np.linalg.norm(cross(u, v), axis=1)


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
