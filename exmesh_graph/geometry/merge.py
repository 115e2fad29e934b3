"""Vertex merging (paper section 4.2): edge collapse that keeps the surface manifold, unfolded and textured.

Beyond the paper: the link condition, a test against flipped and thinner faces, boundary and seam vertices survive,
and the corners of the deleted vertex move to the UV of the survivor in their own chart. `checks: topology` leaves of
these tests what keeps the mesh a manifold, `uv: own` lets those corners keep their UV.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import (
    area_vectors,
    compact,
    face_areas,
    incident_faces,
    lengths,
    next_halfedge,
    opposite_halfedges,
    signed_areas_2d,
    vertex_degrees,
)
from exmesh_graph.geometry.settings import MergeSettings
from exmesh_graph.geometry.topology import (
    Step,
    Topology,
    VertexMap,
    around,
    corner_edge_lengths,
    degeneracy,
    disjoint_pairs,
    link_condition,
    rounded,
)
from exmesh_graph.geometry.vanished import vanished
from exmesh_graph.types.edges import Edges, edges_of

Incident = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Collapses:
    """Planned collapses of disjoint neighbourhoods: `removed` int64 [N] goes into `survivor` int64 [N]."""

    removed: np.ndarray
    survivor: np.ndarray


def merge(
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray,
    uv_faces: np.ndarray,
    rendered: np.ndarray | None = None,
    settings: MergeSettings | None = None,
    *,
    max_rounds: int = 4,
    seed: int = 0,
) -> Topology:
    """Collapse edges of small degenerate or never rendered faces, round after round while there are any.

    vertices  float [V, 3]; faces int [F, 3]; uvs float [T, 2]; uv_faces int [F, 3]
    rendered  int [F], C_rend: pixels of the training views that showed each face; None: only degenerate faces merge

    Survivors do not move. Vertices and UVs that nothing uses are dropped; no UV coordinate moves. Seam-splitting
    charts are never welded. A face that a collapse changed counts as rendered. Parts that have shrunk to nothing
    (`vanished`) go first: no collapse may take the last faces of a closed part.
    """
    settings = settings or MergeSettings()
    if faces.shape != uv_faces.shape or (rendered is not None and len(rendered) != len(faces)):
        raise GeometryError(
            f"{len(faces)} faces, {len(uv_faces)} UV faces"
            + ("" if rendered is None else f", {len(rendered)} contribution counts"),
            expected="one UV face and one count per face",
        )
    rng = np.random.default_rng(seed)
    state = Topology(vertices, faces, uvs, uv_faces, VertexMap(), np.arange(len(faces)), 0)
    state = _only(state, faces, uv_faces, ~vanished(vertices, faces), 0)
    own = settings.uv == "own"
    seen = np.ones(len(faces), bool) if rendered is None else rendered > 0
    total = 0
    for _ in range(max_rounds):
        budget = (len(state.faces) - settings.min_faces) // 2
        plan = plan_merges(state, seen[state.face_source], settings, rng)
        plan = Collapses(plan.removed[: max(budget, 0)], plan.survivor[: max(budget, 0)])
        if len(plan.removed) == 0:
            break
        state = apply_merges(state, plan, own_uv=own)
        total += len(plan.removed)
        if settings.method == "random":
            break
    return Topology(state.vertices, state.faces, state.uvs, state.uv_faces, state.map, state.face_source, total)


def plan_merges(
    state: Topology, seen: np.ndarray, settings: MergeSettings, rng: np.random.Generator | None = None
) -> Collapses:
    """One round: collapses in the order of the sequential pass, most degenerate faces first.

    A collapse changes the faces around both of its vertices and is skipped when one of them has been changed: with
    this the tests made at the start of the round still hold when its turn comes.
    """
    vertices, faces = state.vertices, state.faces
    edges = edges_of(faces)
    score, candidate, options = _candidates(vertices, faces, edges, seen, settings, rng)
    order = np.lexsort((candidate, score))
    halfedge = (3 * candidate[:, None] + options)[order]
    removed, survivor, legal = collapse_ends(state, edges, halfedge.reshape(-1), settings)
    legal &= link_condition(faces, edges, edges.face_edges.reshape(-1)[halfedge.reshape(-1)], len(vertices))
    incident = incident_faces(faces, len(vertices))
    # Of each face the first edge that may collapse; several faces may ask for the same collapse: the first one counts.
    choice = np.full(len(halfedge), -1)
    for option in range(halfedge.shape[1]):
        at = np.arange(len(halfedge)) * halfedge.shape[1] + option
        at = at[(choice < 0) & legal[at]]
        at = at[shape_is_kept(state, removed[at], survivor[at], settings, incident)]
        choice[at // halfedge.shape[1]] = at
    choice = choice[choice >= 0]
    removed, survivor = removed[choice], survivor[choice]
    _, first = np.unique(removed * len(vertices) + survivor, return_index=True)
    first.sort()
    removed, survivor = removed[first], survivor[first]

    go = disjoint_pairs(removed, survivor, incident, len(faces))
    return Collapses(removed[go], survivor[go])


def apply_merges(state: Topology, plan: Collapses, *, own_uv: bool = False) -> Topology:
    """Carry out collapses of disjoint neighbourhoods, then drop unused vertices and UVs and renumber the rest.

    Corners of removed vertices take the survivor's UV, or with `own_uv` keep theirs (the paper's section 4.3).
    """
    goes_to = np.arange(len(state.vertices))
    goes_to[plan.removed] = plan.survivor
    faces = goes_to[state.faces]
    corners = state.uv_faces if own_uv else _moved_corners(state.faces, state.uv_faces, plan, len(state.vertices))
    a, b, c = faces.T
    return _only(state, faces, corners, (a != b) & (b != c) & (c != a), len(plan.removed))


def _only(state: Topology, faces: np.ndarray, corners: np.ndarray, alive: np.ndarray, count: int) -> Topology:
    """The faces that are `alive`, of `faces` and `corners` into the state's vertices and UVs; unused ones go too."""
    kept, new_faces = compact(faces[alive], len(state.vertices))
    kept_uvs, new_corners = compact(corners[alive], len(state.uvs))
    step = Step(kept)
    return Topology(
        step.carry(state.vertices),
        new_faces.astype(state.faces.dtype),
        state.uvs[kept_uvs],
        new_corners.astype(state.uv_faces.dtype),
        state.map.then(step),
        state.face_source[alive],
        count,
    )


def _candidates(
    vertices: np.ndarray,
    faces: np.ndarray,
    edges: Edges,
    seen: np.ndarray,
    settings: MergeSettings,
    rng: np.random.Generator | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(score [N], face [N], corners k of the edges to try in turn [N, options]); the lowest score goes first.

    A boundary edge comes first (paper), then the shorter ones; of equals the first.
    """
    area = rounded(face_areas(vertices, faces))
    small = area <= np.quantile(area, settings.area_quantile)
    if settings.method == "random":
        rng = rng or np.random.default_rng(0)
        face = np.flatnonzero(small & (rng.random(len(faces)) < settings.share))
        return rng.random(len(face)), face, rng.integers(0, 3, (len(face), 1))
    face = np.flatnonzero(small)
    shape = np.round(degeneracy(vertices, faces[face]), 6)
    wanted = ~seen[face] | (shape < settings.degenerate)
    face, shape = face[wanted], shape[wanted]
    boundary = edges.count[edges.face_edges[face]] == 1
    length = corner_edge_lengths(vertices, faces[face])
    relative = np.round(length / np.maximum(length.max(axis=1, keepdims=True), 1e-300), 5)
    options = np.argsort(relative - 2.0 * boundary, axis=1, kind="stable")
    return shape, face, options[:, : settings.tries]


def collapse_ends(
    state: Topology, edges: Edges, halfedge: np.ndarray, settings: MergeSettings, prefer: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(removed, survivor, legal) for each edge.

    The end of lower degree goes (paper), the higher index of equals, or the start where `prefer` bool [N] says so; but
    a boundary vertex outlives an inner one, so that the outline stays, and a seam vertex outlives an inner one of its
    chart, so that the seam stays.
    """
    faces, n = state.faces, len(state.vertices)
    flat = faces.reshape(-1)
    i, j = flat[halfedge].astype(np.int64), flat[next_halfedge(halfedge)].astype(np.int64)
    degree = vertex_degrees(faces, n, edges)
    on_boundary = np.zeros(n, bool)
    on_boundary[edges.vertices[edges.count == 1].reshape(-1)] = True
    owner = np.full(len(state.uvs), -1, np.int64)
    owner[state.uv_faces.reshape(-1)] = flat  # a UV belongs to one vertex
    used = np.flatnonzero(owner >= 0)
    on_seam = np.bincount(owner[used], minlength=n) > 1
    # a seam vertex may go where its corners keep their UVs
    fixed = 2 * on_boundary.astype(np.int64) + (on_seam if settings.uv == "survivor" else 0)
    i_goes = np.where(
        fixed[i] != fixed[j],
        fixed[i] < fixed[j],
        np.where(degree[i] != degree[j], degree[i] < degree[j], i > j) if prefer is None else prefer,
    )
    edge = edges.face_edges.reshape(-1)[halfedge]
    legal = edges.count[edge] <= 2
    legal &= ~((edges.count[edge] == 2) & on_boundary[i] & on_boundary[j])
    removed = np.where(i_goes, i, j)
    if settings.checks == "topology":
        return removed, np.where(i_goes, j, i), legal
    partner = opposite_halfedges(edges)
    border = np.flatnonzero(edges.count[edges.face_edges.reshape(-1)] == 1)
    bend = _outline_cosine(state.vertices, faces, border)
    # the borders of charts: one UV belongs to one vertex, so only the partner can share both ends
    mark, after = state.uv_faces.reshape(-1), next_halfedge(partner)
    half = np.arange(faces.size)
    border = np.flatnonzero((partner < 0) | (mark[after] != mark) | (mark[partner] != mark[next_halfedge(half)]))
    uv_bend = _outline_cosine(state.uvs, state.uv_faces, border)
    np.minimum.at(bend, owner[used], uv_bend[used])
    legal &= np.round(bend[removed], 6) >= settings.outline_cosine
    return removed, np.where(i_goes, j, i), legal


def _outline_cosine(points: np.ndarray, faces: np.ndarray, border: np.ndarray) -> np.ndarray:
    """float64 [V]: cosine of the turn that half-edges `border` make at each vertex; 1 inside, -1 where they meet."""
    start, end = faces.reshape(-1)[border], faces.reshape(-1)[next_halfedge(border)]
    n = len(points)
    arrives, leaves = np.full((2, n, points.shape[1]), np.nan)
    step = points[end].astype(np.float64) - points[start].astype(np.float64)
    step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-300)
    arrives[end], leaves[start] = step, step
    number = np.bincount(start, minlength=n)
    cosine = np.einsum("ij,ij->i", arrives, leaves)
    return np.where(number == 0, 1.0, np.where((number == 1) & np.isfinite(cosine), cosine, -1.0))


def shape_is_kept(
    state: Topology, removed: np.ndarray, survivor: np.ndarray, settings: MergeSettings, incident: Incident
) -> np.ndarray:
    """bool [N]: no remaining face turns over, folds in the atlas or becomes a sliver, and every corner finds its UV.

    With `checks: topology` a face that stays must keep an area, and nothing else is asked of its shape.
    """
    vertices, faces, corners = state.vertices, state.faces, state.uv_faces
    owner, face = around(removed, incident)
    stays = (faces[face] != survivor[owner, None]).all(axis=1)
    owner, face = owner[stays], face[stays]

    before = faces[face]
    is_removed = before == removed[owner, None]
    after = np.where(is_removed, survivor[owner, None], before)
    old, new = area_vectors(vertices, before), area_vectors(vertices, after)
    cosine = np.einsum("ij,ij->i", old, new)
    size2 = lengths(old) * lengths(new)
    shape_old, shape_new = degeneracy(vertices, before), degeneracy(vertices, after)
    bad = shape_new < 1e-6
    if settings.checks == "shape":
        bad |= (cosine <= settings.min_cosine * size2) & (shape_old > 1e-6)
        bad |= shape_new < np.minimum(shape_old, settings.degenerate) * (1.0 - 1e-5)
    safe = np.ones(len(removed), bool)
    if settings.uv == "own":  # no triangle of the atlas changes
        safe[owner[bad]] = False
        return safe

    target, known = _uv_target(faces, corners, removed, survivor, owner, face, is_removed, incident)
    bad |= ~known
    k = is_removed.argmax(axis=1)
    moved = corners[face].astype(np.int64)
    moved[np.arange(len(face)), k] = np.where(known, target, moved[np.arange(len(face)), k])
    if settings.checks == "shape":
        area_old, area_new = signed_areas_2d(state.uvs, corners[face]), signed_areas_2d(state.uvs, moved)
        bad |= (area_old > 0) & (area_new <= 1e-3 * area_old * np.minimum(1.0, settings.degenerate))
    safe[owner[bad]] = False
    return safe


def _uv_target(
    faces: np.ndarray,
    corners: np.ndarray,
    removed: np.ndarray,
    survivor: np.ndarray,
    owner: np.ndarray,
    face: np.ndarray,
    is_removed: np.ndarray,
    incident: Incident,
) -> tuple[np.ndarray, np.ndarray]:
    """(UV index of the survivor for the removed corner of `face`, whether it is known and unambiguous).

    Every face that vanishes says which UV of the survivor lies in the same chart as a UV of the removed vertex.
    """
    own, star = around(removed, incident)
    dies = (faces[star] == survivor[own, None]).any(axis=1)
    own, star = own[dies], star[dies]
    rows = np.arange(len(star))
    uv_removed = corners[star][rows, (faces[star] == removed[own, None]).argmax(axis=1)].astype(np.int64)
    uv_survivor = corners[star][rows, (faces[star] == survivor[own, None]).argmax(axis=1)].astype(np.int64)
    stride = int(corners.max()) + 1
    key = own * stride + uv_removed
    order = np.argsort(key, kind="stable")
    key, value = key[order], uv_survivor[order]
    wanted = owner * stride + corners[face][np.arange(len(face)), is_removed.argmax(axis=1)]
    left = np.minimum(np.searchsorted(key, wanted, "left"), max(len(key) - 1, 0))
    right = np.maximum(np.searchsorted(key, wanted, "right") - 1, 0)
    known = (key[left] == wanted) & (value[left] == value[right])
    return value[left], known


def _moved_corners(faces: np.ndarray, corners: np.ndarray, plan: Collapses, n_vertices: int) -> np.ndarray:
    """Corners after the plan, int64 [F, 3]: those of removed vertices take the survivor's UV."""
    incident = incident_faces(faces, n_vertices)
    owner, face = around(plan.removed, incident)
    stays = (faces[face] != plan.survivor[owner, None]).all(axis=1)
    owner, face = owner[stays], face[stays]
    moved = corners.astype(np.int64)
    if len(face):
        is_removed = faces[face] == plan.removed[owner, None]
        target, _ = _uv_target(faces, corners, plan.removed, plan.survivor, owner, face, is_removed, incident)
        moved[face, is_removed.argmax(axis=1)] = target
    return moved
