"""Decimation that keeps the atlas: edges collapse into one of their ends, the one of least quadric error.

Quadrics of Garland and Heckbert (1997), weighted by face areas and summed over collapses. No vertex and no texture
coordinate moves, so maps stay valid: seams and outlines lose vertices only where they run straight on the surface and
in the atlas. The legality of a collapse is that of `geometry.merge`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import area_vectors, incident_faces, lengths, next_halfedge
from exmesh_graph.geometry.merge import Collapses, apply_merges, collapse_ends, shape_is_kept
from exmesh_graph.geometry.settings import MergeSettings
from exmesh_graph.geometry.topology import Topology, VertexMap, disjoint_pairs, link_condition
from exmesh_graph.types.edges import edges_of

#: Faces keep their normals within 60 degrees a collapse; lines of the outline and of seams turn by 25 degrees at most.
SETTINGS = MergeSettings(degenerate=0.05, min_cosine=0.5, outline_cosine=0.9)
_ROUND = 0.25  # share of the edges, cheapest first, that a round may take: rounds follow the order of costs
_LENGTH = 1e-4  # weight of length^4 in the cost, so that flat regions lose their short edges first


def decimate(
    vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray, target_faces: int
) -> Topology:
    """Collapse edges until `target_faces` are left, or none may collapse: look at the result's number of faces.

    vertices float [V, 3]; faces int [F, 3]; uvs float [T, 2]; uv_faces int [F, 3]. `map` of the result is that of its
    last round only. Raises GeometryError for counts that do not fit.
    """
    if faces.shape != uv_faces.shape or target_faces < 4:
        raise GeometryError(
            f"{len(faces)} faces, {len(uv_faces)} UV faces, {target_faces} wanted",
            expected="one UV face a face, and at least 4 faces wanted",
        )
    state = Topology(vertices, faces, uvs, uv_faces, VertexMap(), np.arange(len(faces)), 0)
    quadrics = vertex_quadrics(vertices, faces)
    total = 0
    while len(state.faces) > target_faces:
        plan = _plan(state, quadrics, (len(state.faces) - target_faces + 1) // 2)
        if len(plan.removed) == 0:
            break
        quadrics[plan.survivor] += quadrics[plan.removed]
        state = apply_merges(replace(state, map=VertexMap()), plan)
        quadrics = state.map.carry(quadrics)
        total += len(plan.removed)
    return replace(state, count=total)


def vertex_quadrics(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [V, 4, 4]: sum over the faces around a vertex of area p p^T, p the plane (n, d) with n.x + d = 0."""
    area = area_vectors(vertices, faces) / 2
    size = lengths(area)
    normal = area / np.maximum(size, 1e-300)[:, None]
    plane = np.concatenate([normal, -(normal * vertices[faces[:, 0]]).sum(1, keepdims=True)], axis=1)
    quadric = size[:, None, None] * plane[:, :, None] * plane[:, None, :]
    total = np.zeros((len(vertices), 4, 4))
    for k in range(3):
        np.add.at(total, faces[:, k], quadric)
    return total


def _plan(state: Topology, quadrics: np.ndarray, budget: int) -> Collapses:
    """One round of disjoint collapses, cheapest first, no more than `budget`."""
    faces, n = state.faces, len(state.vertices)
    edges = edges_of(faces)
    _, halfedge = np.unique(edges.face_edges.reshape(-1), return_index=True)  # one of each edge
    flat = faces.reshape(-1)
    i, j = flat[halfedge].astype(np.int64), flat[next_halfedge(halfedge)].astype(np.int64)
    place = np.concatenate([state.vertices.astype(np.float64), np.ones((n, 1))], axis=1)
    both = quadrics[i] + quadrics[j]
    cost = np.stack([np.einsum("na,nab,nb->n", place[end], both, place[end]) for end in (j, i)])  # i goes, j goes
    removed, survivor, legal = collapse_ends(state, edges, halfedge, SETTINGS, prefer=cost[0] <= cost[1])
    span = lengths(place[i, :3] - place[j, :3])
    price = np.where(removed == i, cost[0], cost[1]) + _LENGTH * span**4
    incident = incident_faces(faces, n)
    order = np.flatnonzero(legal)
    order = order[np.argsort(price[order], kind="stable")]
    for share in (_ROUND, 1.0):  # all of them only when the cheap ones are stuck
        at = order[: max(int(share * len(order)), 64)]
        at = at[link_condition(faces, edges, edges.face_edges.reshape(-1)[halfedge[at]], n)]
        at = at[shape_is_kept(state, removed[at], survivor[at], SETTINGS, incident)]
        if len(at):
            break
    chosen = at[disjoint_pairs(removed[at], survivor[at], incident, len(faces))][:budget]
    return Collapses(removed[chosen], survivor[chosen])
