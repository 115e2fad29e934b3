"""Isotropic remeshing in numpy (after Botsch and Kobbelt 2004): split long edges, collapse short ones, even out the
valences, relax along the surface, go back to the source surface. Every step works on many edges at once, chosen so
that no two touch the same face. Creases keep their place: means across the rim of a thin sheet would eat it up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from exmesh_graph.geometry.adjacency import (
    area_vectors,
    area_weighted_normals,
    compact,
    cross,
    edge_lengths,
    face_areas,
    face_normals,
    incident_faces,
    next_halfedge,
    vertex_degrees,
)
from exmesh_graph.geometry.surface import closest_on_triangles
from exmesh_graph.geometry.topology import greedy_disjoint, link_condition, ranges
from exmesh_graph.types.edges import Edges, edges_of

_ROUNDS = 40
_MIN_COSINE = 0.3
_CREASE = 0.5  # cosine of the angle between two faces' normals below which their edge is a crease
_SMOOTH, _ON_CREASE, _CORNER = 0, 1, 2
_DRIFT = 0.3  # of the length below which edges collapse: how far the boundary may move at once
Arrays = tuple[np.ndarray, np.ndarray]


def remesh(vertices: np.ndarray, faces: np.ndarray, budget: int, iterations: int = 6) -> Arrays:
    """(vertices float64 [V, 3], faces int32 [F, 3]) of about equilateral triangles, F <= `budget`.

    The input must be edge-manifold and consistently wound. Topology is kept (link condition). Boundary vertices stay
    where they are or go, along the boundary: a vertex less than a quarter edge from the line between its neighbours,
    and any other where the budget asks for it. Deterministic.
    """
    to_source = nearest_of(vertices, faces)
    area = float(face_areas(vertices, faces).sum())
    v, f = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    aim = 1.05 * budget
    for _ in range(iterations):
        length = np.sqrt(4 * area / (np.sqrt(3) * aim))
        v, f = _split(v, f, 4 / 3 * length)
        v, f = _collapse(v, f, 4 / 5 * length, 4 / 3 * length)
        f = _flip(v, f)
        v = _relax(v, f)
        v = to_source(v, area_weighted_normals(v, f))
        aim *= np.clip(0.97 * budget / len(f), 0.7, 1.4)
    for _ in range(_ROUNDS):
        if len(f) <= budget:
            break
        v, f = _collapse(v, f, np.inf, np.inf, most=(len(f) - budget + 1) // 2)
    v = _relax(v, f)
    v = _spread(to_source(v, area_weighted_normals(v, f)), f, area / max(len(f), 1))
    return v, f.astype(np.int32)


def _fixed(faces: np.ndarray, count: int, edges: Edges) -> np.ndarray:
    fixed = np.zeros(count, bool)
    fixed[edges.vertices[~edges.interior]] = True
    return fixed


def _split(v: np.ndarray, f: np.ndarray, longest: float) -> Arrays:
    """Halve every edge longer than `longest`."""
    for _ in range(_ROUNDS):
        edges = edges_of(f)
        length = edge_lengths(v, edges)
        long = np.flatnonzero((length > longest) & (edges.count <= 2))
        if len(long) == 0:
            break
        sides = edges.halfedges[long]
        touched = np.where(sides >= 0, sides // 3, sides[:, :1] // 3)
        order = np.empty(len(long), np.int64)
        order[np.argsort(-length[long], kind="stable")] = np.arange(len(long))
        chosen = greedy_disjoint(order, 2 * np.arange(len(long) + 1), touched.reshape(-1), len(f))
        ends = edges.vertices[long[chosen]]
        middle = len(v) + np.arange(len(chosen))
        v = np.concatenate([v, v[ends].mean(1)])
        half, new = sides[chosen].reshape(-1), np.repeat(middle, 2)
        half, new = half[half >= 0], new[half >= 0]
        end, opposite = f.reshape(-1)[next_halfedge(half)], f.reshape(-1)[next_halfedge(next_halfedge(half))]
        f = f.copy()
        f[half // 3, (half + 1) % 3] = new
        f = np.concatenate([f, np.stack([new, end, opposite], axis=1)])
    return v, f


def _collapse(v: np.ndarray, f: np.ndarray, shortest: float, longest: float, most: int | None = None) -> Arrays:
    """Collapse edges shorter than `shortest` to their middle, shortest first, unless that makes an edge longer than
    `longest`, turns a face by more than about 70 degrees, or breaks the link condition. `most`: at most so many.

    An end on a crease, or at a corner of creases, stays in its place if the other is less sharp (`_sharpness`).

    Edges of the boundary collapse to one of their ends, see `_boundary_ends`; others that touch it do not.
    """
    thorough, refused = most is not None, np.empty((0, 2), np.int64)
    for _ in range(_ROUNDS if most is None else 1):
        edges = edges_of(f)
        fixed = _fixed(f, len(v), edges)
        length = edge_lengths(v, edges)
        outline = edges.count == 1
        rank = _sharpness(v, f, edges)[0]
        short = np.flatnonzero((length < shortest) & (outline | (edges.interior & ~fixed[edges.vertices].any(1))))
        # the verdict on an edge holds until a face around it changes
        short = short[~np.isin(edges.vertices[short] @ [len(v), 1], refused @ [len(v), 1])]
        short = short[np.argsort(length[short], kind="stable")]
        if most is not None:
            short = short[: max(20 * most, 100)]
        if not thorough:  # judging an edge costs a dozen faces: look only at edges that are the shortest at both ends
            first = np.full(len(v), len(short), np.int64)
            np.minimum.at(first, edges.vertices[short].T.reshape(-1), np.tile(np.arange(len(short)), 2))
            short = short[(first[edges.vertices[short]] == np.arange(len(short))[:, None]).all(1)]
        judged = edges.vertices[short]
        able = short[link_condition(f, edges, short, len(v))]
        kept, gone, drift = _boundary_ends(v, edges)
        able = able[~outline[able] | (drift[able] < _DRIFT * shortest)]
        a = np.where(outline[able], kept[able], edges.vertices[able, 0])
        b = np.where(outline[able], gone[able], edges.vertices[able, 1])
        keen = rank[a] - rank[b]
        middle = np.where(
            ((keen > 0) | outline[able])[:, None], v[a], np.where((keen < 0)[:, None], v[b], (v[a] + v[b]) / 2)
        )
        offsets, ring, owner = _rings(f, len(v), a, b)
        allowed = _keeps_shape(v, f, a, b, middle, ring, owner, longest)
        keep = np.repeat(allowed, np.diff(offsets))
        refused = np.concatenate([refused, judged[~np.isin(short, able[allowed])]])
        offsets = np.concatenate([[0], np.cumsum(np.diff(offsets)[allowed])])
        a, b, middle, ring = a[allowed], b[allowed], middle[allowed], ring[keep]
        if len(a) == 0 and thorough:
            break
        chosen = greedy_disjoint(np.arange(len(a)), offsets, ring, len(f))
        chosen = chosen[:most] if most is not None else chosen
        thorough = most is not None or len(chosen) < 0.2 * len(short)  # most of the shortest may not go: look further
        fresh = np.zeros(len(v), bool)
        fresh[f[ring[np.isin(owner[keep], np.flatnonzero(allowed)[chosen])]]] = True
        refused = refused[~fresh[refused].any(1)]
        v, target = v.copy(), np.arange(len(v))
        v[a[chosen]] = middle[chosen]
        target[b[chosen]] = a[chosen]
        f = target[f]
        f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
        used, f = compact(f, len(v))
        v, refused = v[used], np.searchsorted(used, refused)
    return v, f


def _boundary_ends(v: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(end kept, end gone, how far the boundary then moves) of every edge; of use for edges of the boundary only.

    The end that goes is the one that lies nearer to the line from the kept end to its own other neighbour.
    """
    outline = np.flatnonzero(edges.count == 1)
    ends = edges.vertices[outline]
    total = np.zeros(len(v), np.int64)
    np.add.at(total, ends.reshape(-1), ends[:, ::-1].reshape(-1))  # two neighbours on a manifold boundary
    beyond = total[ends] - ends[:, ::-1]  # the other neighbour of each end
    beyond = np.where((beyond >= 0) & (beyond < len(v)), beyond, ends)
    away = np.stack([_to_line(v[ends[:, k]], v[ends[:, 1 - k]], v[beyond[:, k]]) for k in (0, 1)], axis=1)
    first = away[:, 0] <= away[:, 1]
    kept, gone = np.zeros(len(edges.count), np.int64), np.zeros(len(edges.count), np.int64)
    drift = np.full(len(edges.count), np.inf)
    kept[outline], gone[outline] = np.where(first, ends[:, 1], ends[:, 0]), np.where(first, ends[:, 0], ends[:, 1])
    drift[outline] = away.min(1)
    return kept, gone, drift


def _to_line(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distance [N] of points to the segments from `start` to `end`, all [N, 3]."""
    along = end - start
    squared = np.einsum("ni,ni->n", along, along)
    share = np.einsum("ni,ni->n", points - start, along) / np.where(squared > 0, squared, 1)
    return np.linalg.norm(points - start - np.clip(share, 0, 1)[:, None] * along, axis=1)


def _rings(f: np.ndarray, count: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(offsets, faces, edge of each): the faces around either end of each edge, those of both ends listed twice."""
    start, faces = incident_faces(f, count)
    ends = np.stack([a, b], axis=1).reshape(-1)
    sizes = start[ends + 1] - start[ends]
    first = np.concatenate([[0], np.cumsum(sizes)])
    offsets = first[::2] if len(a) else np.zeros(1, np.int64)
    return offsets, faces[ranges(start[ends], sizes)], np.repeat(np.arange(len(a)), np.diff(offsets))


def _keeps_shape(
    v: np.ndarray, f: np.ndarray, a: np.ndarray, b: np.ndarray, middle: np.ndarray, ring: np.ndarray,
    owner: np.ndarray, longest: float,
) -> np.ndarray:  # fmt: skip
    corners = f[ring]
    moved = (corners == a[owner, None]) | (corners == b[owner, None])
    stays = np.flatnonzero(moved.sum(1) == 1)
    corners, owner, moved = corners[stays], owner[stays], moved[stays]
    points = v[corners]
    points[moved] = middle[owner]  # row by row: one corner of each
    one, two = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normal = cross(one, two)
    before = area_vectors(v, f)[ring[stays]]
    size = np.sqrt(_squared(normal))
    side = np.sqrt(np.maximum(np.maximum(_squared(one), _squared(two)), _squared(two - one)))
    turned = np.einsum("ni,ni->n", normal, before) < _MIN_COSINE * size * np.sqrt(_squared(before))
    sliver = size < 0.1 * side**2
    allowed = np.ones(len(a), bool)
    allowed[owner[turned | sliver | (side > longest)]] = False
    return allowed


def _squared(a: np.ndarray) -> np.ndarray:
    return np.einsum("ni,ni->n", a, a)


def _flip(v: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Turn edges where that brings the valences of the four vertices nearer to six and keeps the surface's course."""
    for _ in range(4):
        edges = edges_of(f)
        inner = np.flatnonzero(edges.interior)
        here, there = edges.halfedges[inner].T
        flat = f.reshape(-1)
        a, b = flat[here], flat[next_halfedge(here)]
        c, d = flat[next_halfedge(next_halfedge(here))], flat[next_halfedge(next_halfedge(there))]
        excess = vertex_degrees(f, len(v), edges) - np.where(_fixed(f, len(v), edges), 4, 6)
        gain = excess[a] + excess[b] - excess[c] - excess[d] - 2  # half the drop of the sum of squares
        key = np.minimum(c, d) * len(v) + np.maximum(c, d)
        exists = np.isin(key, edges.vertices[:, 0] * len(v) + edges.vertices[:, 1])
        first, second = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
        normals = face_normals(v, f)
        course = normals[here // 3] + normals[there // 3]
        fair = np.ones(len(inner), bool)
        for triangle in (first, second):
            points = v[triangle]
            vector = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
            size = np.linalg.norm(vector, axis=1)
            longest = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2).max(1)
            fair &= (np.einsum("ni,ni->n", vector, course) > 1.8 * size) & (size > 0.2 * longest**2)
        able = np.flatnonzero((gain > 0) & ~exists & fair & (c != d))
        able = able[np.unique(key[able], return_index=True)[1]]
        if len(able) == 0:
            break
        order = np.empty(len(able), np.int64)
        order[np.argsort(-gain[able], kind="stable")] = np.arange(len(able))
        touched = np.stack([here[able] // 3, there[able] // 3], axis=1).reshape(-1)
        chosen = able[greedy_disjoint(order, 2 * np.arange(len(able) + 1), touched, len(f))]
        f = f.copy()
        f[here[chosen] // 3], f[there[chosen] // 3] = first[chosen], second[chosen]
    return f


def _relax(v: np.ndarray, f: np.ndarray, steps: int = 3) -> np.ndarray:
    """Move vertices towards the mean of their neighbours, along the surface only, and along a crease only on it."""
    edges = edges_of(f)
    ends = edges.vertices
    near = csr_matrix((np.ones(2 * len(ends)), (ends.T.reshape(-1), ends[:, ::-1].T.reshape(-1))), shape=(len(v),) * 2)
    degree = np.maximum(np.asarray(near.sum(1)), 1)
    free = ~_fixed(f, len(v), edges)[:, None]
    rank, beside = _sharpness(v, f, edges)
    free &= (rank < _CORNER)[:, None]
    line = rank == _ON_CREASE
    for _ in range(steps):
        move = near @ v / degree - v
        normal = area_weighted_normals(v, f)
        move -= normal * np.einsum("ni,ni->n", move, normal)[:, None]
        one, two = v[beside[line, 0]], v[beside[line, 1]]
        along = (two - one) / np.maximum(np.linalg.norm(two - one, axis=1), 1e-30)[:, None]
        move[line] = along * np.einsum("ni,ni->n", (one + two) / 2 - v[line], along)[:, None]
        v = v + 0.6 * free * move
    return v


def _sharpness(v: np.ndarray, f: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """(int [V]: smooth, on one crease, corner of creases; int [V, 2]: neighbours along the crease, of those on one)."""
    normals = face_normals(v, f)
    inner = np.flatnonzero(edges.interior)
    here, there = (edges.halfedges[inner] // 3).T
    sharp = edges.vertices[inner[np.einsum("ni,ni->n", normals[here], normals[there]) < _CREASE]]
    count = np.bincount(sharp.reshape(-1), minlength=len(v))
    rank = np.where(count == 0, _SMOOTH, np.where(count == 2, _ON_CREASE, _CORNER))
    ends, others = sharp.reshape(-1), sharp[:, ::-1].reshape(-1)
    order = np.argsort(ends, kind="stable")
    beside = np.zeros((len(v), 2), np.int64)
    on = rank == _ON_CREASE
    beside[on] = others[order][on[ends[order]]].reshape(-1, 2)
    return rank, beside


def _spread(v: np.ndarray, f: np.ndarray, mean_area: float) -> np.ndarray:
    """Vertices of faces that the way back to a folded source left without area: nearer to their neighbours' mean."""
    for _ in range(20):
        flat = face_areas(v, f) <= 1e-6 * mean_area
        if not flat.any():
            break
        edges = edges_of(f)
        near, far = edges.vertices.T
        total, count = np.zeros_like(v), np.zeros((len(v), 1))
        for here, there in ((near, far), (far, near)):
            np.add.at(total, here, v[there])
            np.add.at(count, here, 1)
        moved = np.zeros(len(v), bool)
        moved[f[flat]] = True
        moved &= ~_fixed(f, len(v), edges)
        v = np.where(moved[:, None], (v + total / np.maximum(count, 1)) / 2, v)
    return v


def nearest_of(vertices: np.ndarray, faces: np.ndarray) -> Callable[..., np.ndarray]:
    """Function that takes points [P, 3] to the nearest point of the eight triangles whose centroids are nearest.

    With normals [P, 3] as its second argument, of those that face the same way if there are any: the nearest point of
    a thin sheet may lie on its other side.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    tree = cKDTree(corners.mean(1))
    own = face_normals(np.asarray(vertices, np.float64), faces)
    k = min(8, len(corners))

    def project(points: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        _, near = tree.query(points, k=k)
        near = np.asarray(near).reshape(-1, k)
        nearest = closest_on_triangles(np.repeat(points, k, axis=0), corners[near.reshape(-1)]).reshape(-1, k, 3)
        away = ((nearest - points[:, None]) ** 2).sum(2)
        if normals is not None:
            other = np.einsum("pki,pi->pk", own[near], normals) < 0
            away = np.where(other & ~other.all(1, keepdims=True), np.inf, away)
        return nearest[np.arange(len(points)), away.argmin(1)]

    return project
