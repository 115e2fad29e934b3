"""Vertices glide along the surface towards the middle of their neighbours, and their UVs glide with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exmesh_graph.geometry.adjacency import (
    area_vectors,
    area_weighted_normals,
    cross,
    incident_faces,
    lengths,
    signed_areas_2d,
)
from exmesh_graph.geometry.surface import closest_on_triangles
from exmesh_graph.geometry.topology import around, degeneracy
from exmesh_graph.types.edges import edges_of


def relax(
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray,
    uv_faces: np.ndarray,
    *,
    steps: int = 1,
    strength: float = 0.5,
    max_bend: float = 0.5,
    colours: Sequence[np.ndarray] = (),
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """(vertices float32 [V, 3], uvs float32 [T, 2], colours) after `steps` of tangential smoothing; indices stay.

    A vertex moves by `strength` of the way to the mean of its neighbours, along its tangent plane, and takes the UV of
    the nearest point of the old faces around it. It ends between that point and the tangent plane, nearer to the plane
    the larger its own weight in that point is: exact on a surface of second order, where faces are chords.
    Vertices on boundaries and seams stay, and those where the surface bends by more than `max_bend` radians; a move
    that turns a face by more than that, folds it in the atlas or makes it thinner is taken back. `colours` are arrays
    [V, ...] of what is painted on the surface: a vertex takes what lies at its new place.
    """
    edges = edges_of(faces)
    count = len(vertices)
    free = np.ones(count, bool)
    free[edges.vertices[edges.count != 2].reshape(-1)] = False
    marks = np.unique(faces.reshape(-1).astype(np.int64) * len(uvs) + uv_faces.reshape(-1))
    free &= np.bincount(marks // len(uvs), minlength=count) == 1
    mark = np.zeros(count, np.int64)
    mark[marks // len(uvs)] = marks % len(uvs)
    low, high = edges.vertices.T
    degree = np.maximum(np.bincount(edges.vertices.reshape(-1), minlength=count), 1)
    incident = incident_faces(faces, count)
    points, marked, colours = vertices.astype(np.float64), uvs.astype(np.float64), list(colours)
    for _ in range(steps):
        movable = free & _is_flat(points, faces, count, max_bend)
        mean = np.stack([
            np.bincount(np.concatenate([low, high]), np.concatenate([points[high, k], points[low, k]]), count)
            for k in range(3)
        ], axis=1) / degree[:, None]  # fmt: skip
        normal = area_weighted_normals(points, faces)
        move = mean - points
        move -= normal * np.einsum("ij,ij->i", move, normal)[:, None]
        which = np.flatnonzero(movable)
        aim = points[which] + strength * move[which]
        place, face, weights = _on_old_faces(points, faces, which, aim, incident)
        own = np.where(faces[face] == which[:, None], weights, 0.0).sum(axis=1)
        place += own[:, None] * (aim - place)
        place_uv = np.einsum("nk,nkc->nc", weights, marked[uv_faces[face]])
        points, marked, went = _accept(points, marked, faces, uv_faces, which, mark[which], place, place_uv, max_bend)
        for i, values in enumerate(colours):
            colours[i] = values.copy()
            colours[i][which[went]] = np.einsum("nk,nk...->n...", weights[went], values[faces[face[went]]])
    return points.astype(vertices.dtype), marked.astype(uvs.dtype), colours


def _is_flat(points: np.ndarray, faces: np.ndarray, count: int, max_bend: float) -> np.ndarray:
    """bool [V], whether all faces around a vertex lie within `max_bend` of its normal."""
    vector = area_vectors(points, faces)
    size = lengths(vector)
    normal = area_weighted_normals(points, faces)
    cosine = np.einsum("fi,fki->fk", vector, normal[faces]) / np.maximum(size, 1e-300)[:, None]
    flat = np.ones(count, bool)
    flat[faces[cosine < np.cos(max_bend)]] = False
    return flat


def _on_old_faces(
    points: np.ndarray,
    faces: np.ndarray,
    which: np.ndarray,
    aim: np.ndarray,
    incident: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The point [N, 3] of the faces around each vertex `which` that is nearest to `aim`, its face [N] and its weights
    [N, 3] in it."""
    owner, face = around(which, incident)
    corner = points[faces[face]]
    near = closest_on_triangles(aim[owner], corner)
    squared = ((near - aim[owner]) ** 2).sum(axis=1)
    order = np.lexsort((squared, owner))
    first = order[np.searchsorted(owner, np.arange(len(which)))] if len(which) else order
    corner, near, face = corner[first], near[first], face[first]
    whole = area_vectors(points, faces[face])
    scale = np.maximum(np.einsum("ij,ij->i", whole, whole), 1e-300)
    weights = np.stack([
        np.einsum("ij,ij->i", cross(corner[:, (k + 1) % 3] - near, corner[:, (k + 2) % 3] - near), whole) / scale
        for k in range(3)
    ], axis=1)  # fmt: skip
    return near, face, weights


def _accept(
    points: np.ndarray,
    uvs: np.ndarray,
    faces: np.ndarray,
    uv_faces: np.ndarray,
    which: np.ndarray,
    mark: np.ndarray,
    place: np.ndarray,
    place_uv: np.ndarray,
    max_bend: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move, then take back the moves of all corners of faces that came out badly, until none is left.

    Returns (points, uvs, which moves were made bool [N])."""
    new_points, new_uvs = points.copy(), uvs.copy()
    new_points[which], new_uvs[mark] = place, place_uv
    moving = np.zeros(len(points), bool)
    moving[which] = True
    row = np.zeros(len(points), np.int64)
    row[which] = np.arange(len(which))
    face = np.flatnonzero(moving[faces].any(axis=1))
    while len(face):
        corner, uv_corner = faces[face], uv_faces[face]
        old, new = area_vectors(points, corner), area_vectors(new_points, corner)
        old_uv, new_uv = signed_areas_2d(uvs, uv_corner), signed_areas_2d(new_uvs, uv_corner)
        bad = np.einsum("ij,ij->i", new, old) < np.cos(max_bend) * lengths(new) * lengths(old)
        bad |= (old_uv > 0) & (new_uv < 0.1 * old_uv)
        bad |= degeneracy(new_points, corner) < np.minimum(degeneracy(points, corner), 0.2) * (1 - 1e-5)
        back = np.unique(corner[bad])
        back = back[moving[back]]
        moving[back] = False
        new_points[back], new_uvs[mark[row[back]]] = points[back], uvs[mark[row[back]]]
        stopped = np.zeros(len(points), bool)
        stopped[back] = True
        face = np.flatnonzero(stopped[faces].any(axis=1) & moving[faces].any(axis=1))
    return new_points, new_uvs, moving[which]
