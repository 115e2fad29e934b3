"""Vertex splitting (paper section 4.1) with the seam-aware UV update of section 4.3 (eq. 5-6).

A round is the paper's: faces in order of their score, each splits its best edge, skipped when a face it would modify
has already been modified. Several rounds follow within one call until the wished number of faces is reached.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import (
    area_vectors,
    cross,
    face_areas,
    lengths,
    next_halfedge,
    opposite_halfedges,
    vertex_degrees,
)
from exmesh_graph.geometry.settings import SplitSettings
from exmesh_graph.geometry.topology import (
    Step,
    Topology,
    VertexMap,
    corner_edge_lengths,
    greedy_disjoint,
    rank01,
    rounded,
)
from exmesh_graph.types.edges import Edges, edges_of

MU_MIN, MU_MAX = 0.25, 0.75  # a new vertex must lie within this part of its edge


def split(
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray,
    uv_faces: np.ndarray,
    gradient: np.ndarray,
    target_faces: int,
    settings: SplitSettings | None = None,
    *,
    allowed: np.ndarray | None = None,
    max_rounds: int = 64,
    seed: int = 0,
) -> Topology:
    """Split faces by score until `target_faces` is reached, which is never exceeded.

    vertices  float [V, 3]; faces int [F, 3]; uvs float [T, 2]; uv_faces int [F, 3]
    gradient  float [V], the EMA of eq. 1
    allowed   bool [F], faces that may be selected (for instance: seen by some view); all if None
    seed      for the random choices of the ablations
    The surface does not move and keeps its texture: new vertices and their UVs lie on old edges. Ends early when no
    face can be split; method "uniform" splits all of them into four, or none when that exceeds `target_faces`.
    Raises GeometryError for arrays that do not fit together.
    """
    settings = settings or SplitSettings()
    if faces.shape != uv_faces.shape or len(gradient) != len(vertices):
        raise GeometryError(
            f"{len(faces)} faces, {len(uv_faces)} UV faces, {len(vertices)} vertices, {len(gradient)} gradients",
            expected="one UV face per face, one gradient per vertex",
        )
    if settings.method == "uniform":
        unchanged = Topology(vertices, faces, uvs, uv_faces, VertexMap(), np.arange(len(faces)), 0)
        return unchanged if 4 * len(faces) > target_faces else subdivide(vertices, faces, uvs, uv_faces)
    rng = np.random.default_rng(seed)
    source, total = np.arange(len(faces)), 0
    state = Topology(vertices, faces, uvs, uv_faces, VertexMap(), source, 0)
    for _ in range(max_rounds):
        budget = target_faces - len(state.faces)
        if budget <= 0:
            break
        usable = None if allowed is None else allowed[source]
        edges = edges_of(state.faces)
        halfedge, mu = plan_splits(
            state.vertices, state.faces, state.map.carry(gradient), budget, settings, usable, rng, edges
        )
        if len(halfedge) == 0:
            break
        state, parent = apply_splits(state, halfedge, mu, edges)
        source, total = source[parent], total + len(halfedge)
    return Topology(state.vertices, state.faces, state.uvs, state.uv_faces, state.map, source, total)


def plan_splits(
    vertices: np.ndarray,
    faces: np.ndarray,
    gradient: np.ndarray,
    budget: int,
    settings: SplitSettings,
    allowed: np.ndarray | None = None,
    rng: np.random.Generator | None = None,
    edges: Edges | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """One round: (half-edge to split int64 [N], place mu on it float64 [N]), in the order of the paper's pass.

    Adds at most `budget` faces (2 for an interior edge, 1 on a boundary): stops at the first that does not fit.
    """
    edges = edges_of(faces) if edges is None else edges
    score, candidate = _select(vertices, faces, edges, gradient, settings, rng)
    if allowed is not None:
        candidate &= allowed
    degree, every = vertex_degrees(faces, len(vertices), edges), opposite_halfedges(edges)
    chosen = _choose_edges(vertices, faces, degree, every, settings)
    partner = every[chosen]
    mu, valid = _place(vertices, faces, edges, degree, chosen, partner, settings, rng)
    selected = np.flatnonzero(candidate & valid)

    order = np.lexsort((selected, -score[selected]))
    priority = np.empty(len(selected), np.int64)
    priority[order] = np.arange(len(selected))
    other = partner[selected] // 3  # -1 on a boundary
    interior = other >= 0
    size = 1 + interior
    offsets = np.concatenate([[0], np.cumsum(size)])
    touched = np.empty(offsets[-1], np.int64)
    touched[offsets[:-1]] = selected
    touched[offsets[:-1][interior] + 1] = other[interior]
    go = greedy_disjoint(priority, offsets, touched, len(faces))
    go = go[np.cumsum(size[go]) <= budget]
    return chosen[selected[go]], mu[selected[go]]


def apply_splits(
    state: Topology, halfedge: np.ndarray, mu: np.ndarray, edges: Edges | None = None
) -> tuple[Topology, np.ndarray]:
    """Carry out splits of disjoint faces. Returns the new state and the old face that each face is a part of.

    Face (i, j, o) with new vertex s on (i, j) becomes (i, s, o), in its place, and (s, j, o), at the end of the list.

    Equations: 5, 6.
    """
    faces, corners = state.faces, state.uv_faces
    n_vertices, n_faces, n = len(state.vertices), len(faces), len(halfedge)
    flat, uv_flat = faces.reshape(-1), corners.reshape(-1)
    edges = edges_of(faces) if edges is None else edges
    partner = opposite_halfedges(edges)[halfedge]
    i, j = flat[halfedge].astype(np.int64), flat[next_halfedge(halfedge)].astype(np.int64)
    step = Step(np.arange(n_vertices), i, j, mu)

    inner = np.flatnonzero(partner >= 0)
    twin = partner[inner]
    # eq. 5: u_s = (1 - mu) u_a + mu u_b; eq. 6: once more in the space of the neighbour, which runs the other way.
    u_i, u_j = uv_flat[halfedge].astype(np.int64), uv_flat[next_halfedge(halfedge)].astype(np.int64)
    reverse = flat[twin] == j[inner]
    start, end = uv_flat[twin].astype(np.int64), uv_flat[next_halfedge(twin)].astype(np.int64)
    w_i, w_j = np.where(reverse, end, start), np.where(reverse, start, end)
    seam = (w_i != u_i[inner]) | (w_j != u_j[inner])
    own = _lerp(state.uvs, u_i, u_j, mu)
    apart = _lerp(state.uvs, w_i[seam], w_j[seam], mu[inner][seam])
    uv_own = len(state.uvs) + np.arange(n)
    uv_twin = uv_own[inner]
    uv_twin[seam] = len(state.uvs) + n + np.arange(int(seam.sum()))

    half = np.concatenate([halfedge, twin])
    new_vertex = n_vertices + np.concatenate([np.arange(n), inner])
    new_uv = np.concatenate([uv_own, uv_twin])
    face, k = half // 3, half % 3
    new_faces = np.concatenate([faces, faces[face]])
    new_corners = np.concatenate([corners, corners[face]])
    added = n_faces + np.arange(len(half))
    new_faces[face, (k + 1) % 3], new_corners[face, (k + 1) % 3] = new_vertex, new_uv
    new_faces[added, k], new_corners[added, k] = new_vertex, new_uv
    parent = np.concatenate([np.arange(n_faces), face])
    return (
        Topology(
            step.carry(state.vertices),
            new_faces,
            np.concatenate([state.uvs, own, apart]),
            new_corners,
            state.map.then(step),
            parent,
            n,
        ),
        parent,
    )


def face_curvature(vertices: np.ndarray, faces: np.ndarray, edges: Edges | None = None) -> np.ndarray:
    """float64 [F], radians: K_f of eq. 2, the mean angle between the normals of f and of the faces next to it.

    By atan2(|n x n'|, n . n'), exact for coplanar faces; pairs with a face without area do not count; 0 with no pair.

    Equation: 2.
    """
    edges = edges_of(faces) if edges is None else edges
    normal = area_vectors(vertices, faces)
    f, g = edges.faces[edges.interior].T
    one, other = normal[f], normal[g]
    angle = np.arctan2(lengths(cross(one, other)), np.einsum("ij,ij->i", one, other))
    has_area = (np.abs(normal) > 0).any(axis=1)
    counts = (has_area[f] & has_area[g]).astype(np.float64)
    both = np.concatenate([f, g])
    total = np.bincount(both, weights=np.tile(angle * counts, 2), minlength=len(faces))
    number = np.bincount(both, weights=np.tile(counts, 2), minlength=len(faces))
    return total / np.maximum(number, 1.0)


def _select(
    vertices: np.ndarray,
    faces: np.ndarray,
    edges: Edges,
    gradient: np.ndarray,
    settings: SplitSettings,
    rng: np.random.Generator | None,
) -> tuple[np.ndarray, np.ndarray]:
    """(score float64 [F], candidate bool [F]).

    G is in loss per length and K in radians: by `ranks`, each becomes its rank in the mesh, so that 0.6 and 0.4 mean
    the same at every scale and for every loss. By `values` they are added as they are (eq. 3 as printed).

    Equation: 3.
    """
    area = face_areas(vertices, faces)
    relative = rounded(area)
    candidate = (relative >= np.quantile(relative, settings.area_quantile)) & (area > 0)
    if settings.method == "area":
        return relative, candidate
    if settings.method == "random":
        return (rng or np.random.default_rng(0)).random(len(faces)), candidate
    gradient_f = gradient.astype(np.float64)[faces].mean(axis=1)
    curvature_f = face_curvature(vertices, faces, edges)
    if settings.score == "values":
        score = settings.gradient_weight * gradient_f + settings.curvature_weight * curvature_f
        return rounded(score), candidate
    score = settings.gradient_weight * rank01(gradient_f) + settings.curvature_weight * rank01(curvature_f)
    return np.round(score, 9), candidate


def _choose_edges(
    vertices: np.ndarray, faces: np.ndarray, degree: np.ndarray, partner: np.ndarray, settings: SplitSettings
) -> np.ndarray:
    """int64 [F], the half-edge of each face with the highest S_e = length / mean degree; the first of equals."""
    if settings.edge_degrees == "endpoints":
        mean_degree = 0.5 * (degree[faces] + degree[np.roll(faces, -1, axis=1)])
    else:
        across = np.roll(degree[faces], -2, axis=1)  # of the corner opposite to half-edge k
        partner = partner.reshape(-1, 3)
        beyond = degree[faces.reshape(-1)[next_halfedge(next_halfedge(np.maximum(partner, 0)))]]
        mean_degree = np.where(partner >= 0, 0.5 * (across + beyond), across)
    score = corner_edge_lengths(vertices, faces) / mean_degree
    best = (score >= score.max(axis=1, keepdims=True) * (1.0 - 1e-5)).argmax(axis=1)
    return 3 * np.arange(len(faces)) + best


def _place(
    vertices: np.ndarray,
    faces: np.ndarray,
    edges: Edges,
    degree: np.ndarray,
    halfedge: np.ndarray,
    partner: np.ndarray,
    settings: SplitSettings,
    rng: np.random.Generator | None,
) -> tuple[np.ndarray, np.ndarray]:
    """(mu float64 [F], valid bool [F]) of the new vertex on the chosen half-edge (i, j) of every face."""
    flat = faces.reshape(-1)
    points = vertices.astype(np.float64)
    i, j = flat[halfedge], flat[next_halfedge(halfedge)]
    c = flat[next_halfedge(next_halfedge(halfedge))]
    inner = partner >= 0
    d = np.where(inner, flat[next_halfedge(next_halfedge(np.maximum(partner, 0)))], c)
    along = points[j] - points[i]
    length2 = np.einsum("ij,ij->i", along, along)
    safe = np.where(length2 > 0, length2, 1.0)
    t_c = np.einsum("ij,ij->i", points[c] - points[i], along) / safe
    t_d = np.einsum("ij,ij->i", points[d] - points[i], along) / safe
    if settings.position == "projection":
        mu = np.where(inner, 0.5 * (t_c + t_d), 0.5)
    elif settings.position == "midpoint":
        mu = np.full(len(halfedge), 0.5)
    else:
        u = (rng or np.random.default_rng(0)).random(len(halfedge))
        mu = MU_MIN + (MU_MAX - MU_MIN) * u
    valid = (mu >= MU_MIN - 1e-6) & (mu <= MU_MAX + 1e-6) & (length2 > 0)
    valid &= edges.count[edges.face_edges.reshape(-1)[halfedge]] <= 2
    valid &= (degree[c] < settings.max_degree) & (degree[d] < settings.max_degree)
    return mu, valid


def _lerp(values: np.ndarray, a: np.ndarray, b: np.ndarray, mu: np.ndarray) -> np.ndarray:
    weight = mu[:, None]
    return ((1.0 - weight) * values[a] + weight * values[b]).astype(values.dtype)


def subdivide(vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray) -> Topology:
    """Midpoint subdivision, 4 F faces; the surface and its texture stay as they are.

    A midpoint gets one UV per edge of the atlas, so that seams stay seams and islands stay apart (eq. 5-6).
    Faces 0 .. F-1 keep corner 0, the next F corner 1, then corner 2, then the middle ones.

    Equations: 5, 6.
    """
    edges, uv_edges = edges_of(faces), edges_of(uv_faces)
    step = Step(np.arange(len(vertices)), edges.vertices[:, 0], edges.vertices[:, 1], np.full(len(edges), 0.5))
    ends = uvs[uv_edges.vertices]
    middle = (0.5 * (ends[:, 0] + ends[:, 1])).astype(uvs.dtype)
    return Topology(
        step.carry(vertices),
        _quarters(faces, edges.face_edges + len(vertices)),
        np.concatenate([uvs, middle]),
        _quarters(uv_faces, uv_edges.face_edges + len(uvs)),
        VertexMap((step,)),
        np.tile(np.arange(len(faces)), 4),
        len(faces),
    )


def _quarters(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    a, b, c = corners.T
    ab, bc, ca = middles.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts]).astype(corners.dtype)
