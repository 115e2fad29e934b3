"""The charts of a mesh and their flat layout: discs as large as can be laid flat without folds, overlaps and stretch.

Every step is direct or has a fixed number of rounds, and what fails is taken apart until it is a single face: there is
nothing that could run for ever, on whatever mesh.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import area_vectors, components, corner_fans, face_areas
from exmesh_graph.types.edges import Edges, edges_of
from exmesh_graph.uv.charts import Rejoin, partition
from exmesh_graph.uv.flatten import flat_corners, flatten, stretches
from exmesh_graph.uv.marks import shelves, winding

_MOST_STRETCH = (
    1.5  # of the texels of a patch against those of its chart: single faces of a rough surface vary more ...
)
_STRETCHED = 0.05  # ... for at most this part of the chart's area
_FOLDED = 0.01  # part of a chart's faces that may be left folded: they get islands of their own
_CELLS = 512  # along the side of a square as large as the mesh: what overlaps are looked for with
_OVERLAP = 2  # cells of a chart that may lie over one another: less than the texels along its border
_UNTANGLE = 8


def lay_out(points: np.ndarray, faces: np.ndarray, bend: float) -> tuple[np.ndarray, np.ndarray]:
    """Cut the mesh into charts and lay them flat.

    points  float64 [V, 3], scaled to a mean face area of 1; faces int [F, 3], edge-manifold, of consistent winding
    bend    how far a chart may bend: bound of 1 - |mean normal|^2
    Returns flat float64 [T, 2], in the unit of `points`, and corners int64 [F, 3] into it: charts are its components.
    """
    edges = edges_of(faces)
    parts = partition(points, faces, edges, bend)
    centres = points[faces].mean(axis=1)
    sheet = _Sheet(points, faces, edges)
    while parts.roots:
        bad = sheet.put(parts.regions(), parts.patch)
        parts.roots = [half for k in bad for half in parts.halves(parts.roots[k], centres)]
    chart = components(sheet.corners)
    again = Rejoin(points, faces, edges, bend, chart)
    while (wish := again.wish()) is not None:
        again.done(sheet.put(wish, chart))
    used, corners = np.unique(sheet.corners, return_inverse=True)
    flat = np.concatenate(sheet.flat)[used]
    return np.stack([flat.real, flat.imag], axis=1), corners.reshape(-1, 3)


class _Sheet:
    """Charts that have been laid flat: corners int64 [F, 3] into the joint parts of `flat`, complex."""

    def __init__(self, points: np.ndarray, faces: np.ndarray, edges: Edges) -> None:
        self.points, self.faces, self.edges = points, faces, edges
        self.corners = np.full(faces.shape, -1, np.int64)
        self.flat: list[np.ndarray] = []
        self.count, self.area = 0, float(face_areas(points, faces).sum())

    def put(self, region: np.ndarray, patch: np.ndarray) -> np.ndarray:
        """Lay the regions (int64 [F], -1: not asked for) flat; those that cannot be are returned and stay as they were.

        patch  int64 [F], parts of regions within which texels should not vary
        """
        here = np.flatnonzero(region >= 0)
        faces, region = self.faces[here], region[here]
        fans, vertex, chart = _cut_open(faces, self.edges if len(here) == len(self.faces) else edges_of(faces), region)
        disc = _are_discs(fans, chart)
        flat, ok = np.zeros(len(vertex), np.complex128), np.zeros(len(disc), bool)
        if disc.any():
            flat, ok = _flatten(self.points, fans, vertex, chart, disc[chart], patch[here], self.area)
        bad = np.unique(region[~ok[chart]])
        good = ~np.isin(region, bad)
        used, index = np.unique(fans[good], return_inverse=True)
        self.corners[here[good]] = index.reshape(-1, 3) + self.count
        self.flat.append(flat[used])
        self.count += len(used)
        return bad


def _cut_open(faces: np.ndarray, edges: Edges, region: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(corners over chart vertices [F, 3], mesh vertex of each, chart of each face), cut between regions."""
    first, second = edges.halfedges.T // 3
    keep = edges.interior & (region[first] == region[second])
    fans, vertex = corner_fans(faces, edges, keep)
    return fans, vertex, components(fans)


def _are_discs(fans: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """bool [charts]: Euler characteristic 1, or a single face."""
    edges = edges_of(fans)
    n = int(chart.max()) + 1
    owner = np.empty(int(fans.max()) + 1, np.int64)
    owner[fans.reshape(-1)] = np.repeat(chart, 3)
    faces = np.bincount(chart, minlength=n)
    euler = np.bincount(owner, minlength=n) - np.bincount(owner[edges.vertices[:, 0]], minlength=n) + faces
    return (euler == 1) | (faces == 1)


def _flatten(
    points: np.ndarray,
    fans: np.ndarray,
    vertex: np.ndarray,
    chart: np.ndarray,
    use: np.ndarray,
    patch: np.ndarray,
    whole: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(layout complex [chart vertices], bool [charts]: fit to be used) of the charts of the faces `use`."""
    n = int(chart.max()) + 1
    there, index = np.unique(fans[use], return_inverse=True)
    faces, owner = index.reshape(-1, 3), chart[use]
    space = points[vertex[there]]
    shape = flat_corners(space, faces)
    place = flatten(shape, faces, len(there), _projected(space, faces, owner, n))
    area = face_areas(space, faces)
    place = _untangle(place, faces, shape, area)

    low, high = stretches(shape, faces, place)
    real = area > 1e-7
    folded = real & (low <= 1e-3)
    size = np.bincount(owner, minlength=n)
    ok = np.bincount(owner, folded, n) <= np.where(size > 20, np.maximum(_FOLDED * size, 1), 0)
    ok &= _unevenness(area, area * np.maximum(low * high, 0.0), patch[use], owner, n) <= _STRETCHED
    ok &= _overlaps(place, faces, owner, n, whole) <= _OVERLAP
    ok |= size == 1
    ok[np.setdiff1d(np.arange(n), owner)] = False
    flat = np.zeros(len(vertex), np.complex128)
    flat[there] = place
    return flat, ok


def _unevenness(space: np.ndarray, flat: np.ndarray, patch: np.ndarray, chart: np.ndarray, n: int) -> np.ndarray:
    """Part of each chart's area in patches whose texels are much larger or smaller than the chart's are on average."""
    _, patch = np.unique(patch, return_inverse=True)
    owner = np.zeros(int(patch.max()) + 1, np.int64)
    owner[patch] = chart
    before, after = np.bincount(patch, space), np.bincount(patch, flat)
    total = np.maximum(np.bincount(owner, before, n), 1e-300)
    growth = (np.bincount(owner, after, n) / total)[owner] * before
    uneven = (after > _MOST_STRETCH**2 * growth) | (after * _MOST_STRETCH**2 < growth)
    return np.bincount(owner, before * uneven, n) / total


def _projected(points: np.ndarray, faces: np.ndarray, chart: np.ndarray, n: int) -> np.ndarray:
    """Charts seen along their mean normal: complex [V]."""
    vectors = area_vectors(points, faces)
    normal = np.stack([np.bincount(chart, vectors[:, k], n) for k in range(3)], axis=1)
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    right = np.cross(axis, normal)
    up = np.cross(normal, right)
    for direction in (right, up):
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        direction /= np.where(length > 0, length, 1.0)
    owner = np.empty(len(points), np.int64)
    owner[faces.reshape(-1)] = np.repeat(chart, 3)
    return np.einsum("ij,ij->i", points, right[owner]) + 1j * np.einsum("ij,ij->i", points, up[owner])


def _untangle(place: np.ndarray, faces: np.ndarray, shape: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Move the inner vertices of folded faces amid their neighbours, which unfolds most."""
    if not ((stretches(shape, faces, place)[0] <= 1e-3) & (area > 1e-7)).any():
        return place
    edges = edges_of(faces)
    inner = np.ones(len(place), bool)
    inner[edges.vertices[edges.count == 1].reshape(-1)] = False
    a, b = edges.vertices.T
    degree = np.bincount(np.concatenate([a, b]), minlength=len(place))
    for _ in range(_UNTANGLE):
        folded = (stretches(shape, faces, place)[0] <= 1e-3) & (area > 1e-7)
        move = np.zeros(len(place), bool)
        move[faces[folded].reshape(-1)] = True
        move &= inner
        if not move.any():
            break
        close = move[a] | move[b]
        i, j = np.concatenate([a[close], b[close]]), np.concatenate([b[close], a[close]])
        total = np.bincount(i, place[j].real, len(place)) + 1j * np.bincount(i, place[j].imag, len(place))
        place = np.where(move, total / np.maximum(degree, 1), place)
    return place


def _overlaps(place: np.ndarray, faces: np.ndarray, chart: np.ndarray, n: int, area: float) -> np.ndarray:
    """int [n], cells in which each chart lies over itself: all charts on one sheet, side by side."""
    edges = edges_of(faces)
    half = edges.halfedges[edges.count == 1, 0]
    face, k = half // 3, half % 3
    x = place.real * (_CELLS / np.sqrt(area))
    y = place.imag * (_CELLS / np.sqrt(area))
    tail, head, owner = faces[face, k], faces[face, (k + 1) % 3], chart[face]
    corner = np.repeat(chart, 3)
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    for axis, value in enumerate((x, y)):
        np.minimum.at(low[:, axis], corner, value[faces.reshape(-1)])
        np.maximum.at(high[:, axis], corner, value[faces.reshape(-1)])
    there = np.isfinite(low[:, 0])
    low[~there] = high[~there] = 0.0
    low, size = np.floor(low), np.ceil(high - np.floor(low)).astype(np.int64) + 1
    left, top, sheet = shelves(size[:, 0], size[:, 1], 0)
    dx, dy = left - low[:, 0], top - low[:, 1]
    around = np.abs(winding(x[tail] + dx[owner], y[tail] + dy[owner], x[head] + dx[owner], y[head] + dy[owner], sheet))
    rows, columns = np.nonzero(around > 1)
    doubled = np.zeros(n, np.int64)
    if len(rows):
        for c in range(n):
            inside = (rows >= top[c]) & (rows < top[c] + size[c, 1])
            doubled[c] = int((inside & (columns >= left[c]) & (columns < left[c] + size[c, 0])).sum())
    return doubled
