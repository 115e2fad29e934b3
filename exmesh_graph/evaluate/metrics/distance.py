"""Distance from points to a triangle mesh: by Warp's hierarchy, and in a plain form.

Plain, exact in float64, with numpy and scipy's k-d tree: a triangle with centroid m lies in the ball (m, r), r the
distance to its farthest corner. Any triangle bounds the answer u from above, and only triangles with |p - m| < u + r
can beat it, which k-d trees over the centroids list. The triangles are put in classes of like size, so that one large
one does not widen every search.
"""

from __future__ import annotations

from functools import cache
from itertools import chain
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.unit import unit_mesh
from exmesh_graph.gpu.cores import split
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.gpu.warp_runtime import warp

_CHUNK = 4096
_NEAREST = 8
_GRAIN = 1024
"""Points that a core takes at a time."""
_NEEDLE = 0.03
"""Height over longest edge below which Warp's float32 may miss a triangle by 1e-5 of the mesh's radius and more."""


def distance_to_mesh(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unsigned distance float64 [P] from points [P, 3] to the nearest point of the triangles (V [V, 3], F [F, 3]).

    At most some 1e-6 of the mesh's radius too large, never too small; degenerate triangles count.
    Raises GeometryError for a mesh without faces or vertices that are not finite.
    """
    if len(faces) == 0:
        raise GeometryError("a mesh without faces has no distance")
    wp = warp()
    faces = np.ascontiguousarray(faces, np.int32)
    unit, centre, radius = unit_mesh(vertices, faces)
    corners = (np.asarray(vertices, np.float64) - centre) / radius
    thin = faces[_needles(corners[faces])]
    at = wp.array(unit, dtype=wp.vec3, device="cpu")
    meshes = [wp.Mesh(at, wp.array(part.reshape(-1), dtype=int, device="cpu")) for part in (faces, thin) if len(part)]
    found = torch.empty(len(points), dtype=torch.float64)
    asked = np.ascontiguousarray((np.asarray(points, np.float64) - centre) / radius)
    split(
        _kernels().distance, len(found), meshes[0].id, meshes[-1].id, len(thin),
        *map(tensor_of, (corners, faces, thin if len(thin) else faces, asked)), found, grain=_GRAIN,
    )  # fmt: skip
    return radius * found.numpy()


def distance_to_mesh_plain(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The same, exact to float64 rounding: the reference."""
    points = np.asarray(points, np.float64)
    corners = np.asarray(vertices, np.float64)[np.asarray(faces)]
    centroids = corners.mean(1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(1)
    classes = [(members, cKDTree(centroids[members])) for members in _size_classes(radii)]
    out = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        out[part] = _distances(points[part], corners, centroids, radii, classes)
    return out


def _needles(corners: np.ndarray) -> np.ndarray:
    """Which of the triangles [F, 3, 3] are thin, or hardly there."""
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.einsum("fij,fij->fi", edges, edges).max(axis=1)
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return (doubled <= _NEEDLE * longest) | (longest < 1e-12)


@cache
def _kernels() -> Any:
    warp()
    from exmesh_graph.evaluate.metrics import kernels_distance

    return kernels_distance


def _size_classes(radii: np.ndarray) -> list[np.ndarray]:
    """Indices of the triangles, grouped by powers of two of their radius."""
    size = np.floor(np.log2(np.maximum(radii, 1e-6 * radii.max() + 1e-300)))
    return [np.flatnonzero(size == value) for value in np.unique(size)]


def _distances(
    points: np.ndarray,
    corners: np.ndarray,
    centroids: np.ndarray,
    radii: np.ndarray,
    classes: list[tuple[np.ndarray, cKDTree]],
) -> np.ndarray:
    best = np.full(len(points), np.inf)
    beyond = []  # of each class: how far its triangles' centroids lie that were not looked at yet
    for members, tree in classes:
        away, near = tree.query(points, k=range(1, min(_NEAREST, len(members)) + 1))
        pairs = squared_distance(np.repeat(points, near.shape[1], axis=0), corners[members[near.ravel()]])
        best = np.minimum(best, pairs.reshape(near.shape).min(1))
        beyond.append(away[:, -1] if near.shape[1] < len(members) else np.full(len(points), np.inf))
    for (members, tree), last in zip(classes, beyond, strict=True):
        reach = np.sqrt(best) * (1 + 1e-9) + radii[members].max()
        open_ = np.flatnonzero(last <= reach)
        lists = tree.query_ball_point(points[open_], reach[open_], return_sorted=False)
        counts = np.fromiter((len(near) for near in lists), np.int64, len(lists))
        owner = np.repeat(open_, counts)
        triangle = members[np.fromiter(chain.from_iterable(lists), np.int64, int(counts.sum()))]
        gap = np.linalg.norm(points[owner] - centroids[triangle], axis=1) - radii[triangle]
        close = gap <= np.sqrt(best)[owner]
        owner, triangle = owner[close], triangle[close]
        for start in range(0, len(owner), 1 << 18):
            part = slice(start, start + (1 << 18))
            np.minimum.at(best, owner[part], squared_distance(points[owner[part]], corners[triangle[part]]))
    return np.sqrt(best)


def squared_distance(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Squared distance float64 [N] of points [N, 3] to triangles [N, 3, 3], pair by pair.

    Where the foot of the perpendicular lies inside, the distance to the plane; otherwise that to the nearest edge.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    area = np.einsum("ni,ni->n", normal, normal)
    to = points - a
    # Barycentric coordinates of the foot, times |normal|^2.
    v = np.einsum("ni,ni->n", np.cross(to, c - a), normal)
    w = np.einsum("ni,ni->n", np.cross(b - a, to), normal)
    inside = (v >= 0) & (w >= 0) & (v + w <= area) & (area > 0)
    edges = np.minimum(_to_segment(points, a, b), np.minimum(_to_segment(points, b, c), _to_segment(points, c, a)))
    plane = np.einsum("ni,ni->n", to, normal) ** 2 / np.where(area > 0, area, 1)
    return np.where(inside, np.minimum(plane, edges), edges)


def _to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along, to = b - a, points - a
    length = np.einsum("ni,ni->n", along, along)
    t = np.clip(np.einsum("ni,ni->n", to, along) / np.where(length > 0, length, 1), 0, 1)
    rest = to - t[:, None] * along
    return np.einsum("ni,ni->n", rest, rest)
