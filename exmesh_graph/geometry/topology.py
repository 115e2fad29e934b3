"""What operations on a mesh's topology share: their result, how attributes follow, legality, order, triangle shape."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from exmesh_graph.geometry.adjacency import face_areas, lengths, neighbours, next_halfedge
from exmesh_graph.types.edges import Edges


@dataclass(frozen=True, eq=False)
class Step:
    """One operation: the kept vertices first, then the new ones, each on an edge of the old mesh.

    kept   int64 [K], old index of each kept vertex
    a, b   int64 [N], old indices of the ends of the edge that carries each new vertex
    mu     float64 [N], its place: (1 - mu) a + mu b
    """

    kept: np.ndarray
    a: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    b: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    mu: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def carry(self, values: np.ndarray, new: str = "interpolate") -> np.ndarray:
        """`values` [V, ...] at the old vertices -> at the new ones; new = "interpolate" or "zero"."""
        mu = self.mu.reshape(-1, *[1] * (values.ndim - 1))
        added = (1.0 - mu) * values[self.a] + mu * values[self.b]
        if new == "zero":
            added = np.zeros_like(added)
        return np.concatenate([values[self.kept], added.astype(values.dtype)])


@dataclass(frozen=True, eq=False)
class VertexMap:
    """A sequence of steps: what several rounds of splits or merges did to the vertices."""

    steps: tuple[Step, ...] = ()

    def then(self, step: Step) -> VertexMap:
        """This map followed by `step`."""
        return VertexMap((*self.steps, step))

    def carry(self, values: np.ndarray, new: str = "interpolate") -> np.ndarray:
        """Carry a per-vertex attribute [V, ...] through all steps; the dtype stays.

        new  what a new vertex gets: "interpolate" between the ends of its edge, or "zero". Adam's moments are
             interpolated: with a zero second moment and a late step count the first update of a new vertex is
             (1 - b1) / sqrt(1 - b2) = 3 learning rates long, whatever its gradient.
        """
        for step in self.steps:
            values = step.carry(values, new)
        return values


@dataclass(frozen=True, eq=False)
class Topology:
    """A mesh with its atlas after an operation.

    vertices float [V, 3], faces int32 [F, 3], uvs float [T, 2], uv_faces int32 [F, 3]
    map      how per-vertex attributes follow
    face_source int64 [F], the face of the mesh before the operation that each face is a part of
    count    operations carried out
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray
    uv_faces: np.ndarray
    map: VertexMap
    face_source: np.ndarray
    count: int


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
    place = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
    common = np.bincount(owner, weights=known[place] == key, minlength=len(edge))

    sides = edges.halfedges[edge]
    on_boundary = np.zeros(n_vertices, bool)
    on_boundary[edges.vertices[edges.count == 1].reshape(-1)] = True
    opposite = faces.reshape(-1)[next_halfedge(next_halfedge(np.maximum(sides, 0)))]
    enough = (degree[opposite] > np.where(on_boundary[opposite], 2, 3)) | (sides < 0)
    return (common == edges.count[edge]) & enough.all(axis=1)


def greedy_disjoint(priority: np.ndarray, offsets: np.ndarray, touched: np.ndarray, n_faces: int) -> np.ndarray:
    """The operations that a sequential pass carries out: in order, skipping what touches a face already changed.

    priority  int [N], a permutation: 0 goes first
    offsets, touched   operation n touches the faces touched[offsets[n]:offsets[n + 1]]
    Returns their indices in order of priority. Every turn accepts all operations that go first on each of their faces
    and drops the ones they exclude; this is the lexicographically first independent set, found in few turns.
    """
    operation = np.repeat(np.arange(len(priority)), np.diff(offsets))
    face = touched
    accepted = np.zeros(len(priority), bool)
    while len(operation):
        first = np.full(n_faces, len(priority), np.int64)
        np.minimum.at(first, face, priority[operation])
        beaten = np.zeros(len(priority), bool)
        beaten[operation[first[face] < priority[operation]]] = True
        wins = operation[~beaten[operation]]
        accepted[wins] = True
        changed = np.zeros(n_faces, bool)
        changed[face[~beaten[operation]]] = True
        out = ~beaten
        out[operation[changed[face]]] = True
        left = ~out[operation]
        operation, face = operation[left], face[left]
    chosen = np.flatnonzero(accepted)
    return chosen[np.argsort(priority[chosen], kind="stable")]


def rounded(values: np.ndarray) -> np.ndarray:
    """Values relative to their largest magnitude, rounded to 1e-6: equal up to float32 rounding means equal."""
    largest = np.abs(values).max(initial=0.0)
    return np.round(values / largest, 6) if largest > 0 else np.zeros_like(values)


def rank01(values: np.ndarray) -> np.ndarray:
    """The rank of each value in its own mesh, in [0, 1]; equal values share their mean rank. Scale free."""
    _, inverse, count = np.unique(rounded(values), return_inverse=True, return_counts=True)
    end = np.cumsum(count)
    mean_rank = end - 0.5 * (count + 1)
    return (mean_rank / max(len(values) - 1, 1))[inverse]


def ranges(first: np.ndarray, size: np.ndarray) -> np.ndarray:
    """first[0], first[0] + 1, ... (size[0] of them), first[1], ..."""
    return np.arange(int(size.sum())) + np.repeat(first - (np.cumsum(size) - size), size)


def around(items: np.ndarray, incident: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(place in `items`, face) of each face around each of the vertices `items`; `incident`: `incident_faces`."""
    start, faces = incident
    size = start[items + 1] - start[items]
    return np.repeat(np.arange(len(items)), size), faces[ranges(start[items], size)]


def disjoint_pairs(
    removed: np.ndarray, survivor: np.ndarray, incident: tuple[np.ndarray, np.ndarray], n_faces: int
) -> np.ndarray:
    """The pairs of vertices, in order, whose faces no earlier pair has touched (`greedy_disjoint`)."""
    pair = np.stack([removed, survivor], axis=1).reshape(-1)
    owner, touched = around(pair, incident)
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner // 2, minlength=len(removed)))])
    return greedy_disjoint(np.arange(len(removed)), offsets, touched, n_faces)


def degeneracy(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F], D_f = Area(f) / l_max(f)^2 (eq. 4): sqrt(3)/4 when equilateral, 0 for a sliver or a point.

    Equation: 4.
    """
    longest2 = (corner_edge_lengths(vertices, faces) ** 2).max(axis=1)
    area = face_areas(vertices, faces)
    return np.divide(area, longest2, out=np.zeros_like(area), where=longest2 > 0)


def corner_edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F, 3], the length of half-edge 3 f + k."""
    points = vertices.astype(np.float64)
    corner = [points[faces[:, k]] for k in range(3)]
    return np.stack([lengths(corner[(k + 1) % 3] - corner[k]) for k in range(3)], axis=1)
