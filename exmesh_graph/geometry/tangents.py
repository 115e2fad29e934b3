"""Tangent frames of a mesh with an atlas, for tangent-space normal maps (+Y up, the OpenGL and USD convention).

The rules are MikkTSpace's (Mikkelsen 2008): per face the direction in which u grows, in the plane of each corner's
smooth normal and weighted by the corner's angle; averaged over the corners that share vertex, texture coordinate and
handedness, so that frames are smooth inside charts and split at seams and where a chart is mirrored.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import angle_weighted_normals


def corner_tangents(
    vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, uv_faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(tangent float32 [F, 3, 3], handedness float32 [F], +1 or -1); bitangent = handedness * normal x tangent.

    vertices [V, 3], faces [F, 3], uvs [T, 2] (v up), uv_faces [F, 3]. Tangents are unit and orthogonal to the
    corner's angle-weighted vertex normal. Faces without area in the atlas take the frame of the corners they share, or
    any frame that fits the normal.
    """
    points, coordinates = np.asarray(vertices, np.float64)[faces], np.asarray(uvs, np.float64)[uv_faces]
    normals = angle_weighted_normals(vertices, faces)[faces]
    e1, e2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    (u1, v1), (u2, v2) = (coordinates[:, k].T - coordinates[:, 0].T for k in (1, 2))
    area = u1 * v2 - u2 * v1
    sign = np.where(area < 0, -1.0, 1.0)
    along = (v2[:, None] * e1 - v1[:, None] * e2) * sign[:, None]  # |area| d position / d u
    flat = np.broadcast_to(along[:, None], points.shape)
    flat = _unit(flat - (flat * normals).sum(-1, keepdims=True) * normals)
    flat[area == 0] = 0
    key = np.stack([faces.reshape(-1), _same_places(uvs)[uv_faces].reshape(-1), np.repeat(sign > 0, 3)], axis=1)
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.reshape(-1)
    total = np.zeros((group.max(initial=-1) + 1, 3))
    np.add.at(total, group, (flat * _angles(points)[..., None]).reshape(-1, 3))
    tangent = _unit(total)[group].reshape(points.shape)
    tangent = _unit(tangent - (tangent * normals).sum(-1, keepdims=True) * normals)
    empty = (tangent == 0).all(-1)
    tangent[empty] = _perpendicular(normals[empty])
    return tangent.astype(np.float32), sign.astype(np.float32)


def _same_places(uvs: np.ndarray) -> np.ndarray:
    """One number per distinct texture coordinate: per-corner lists repeat the coordinates of shared corners."""
    _, place = np.unique(np.asarray(uvs, np.float32), axis=0, return_inverse=True)
    return np.asarray(place).reshape(-1)


def _angles(points: np.ndarray) -> np.ndarray:
    """Interior angles [F, 3] of triangles [F, 3, 3]."""
    result = np.empty(points.shape[:2])
    for k in range(3):
        a, b = points[:, (k + 1) % 3] - points[:, k], points[:, (k + 2) % 3] - points[:, k]
        result[:, k] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
    return result


def _perpendicular(normals: np.ndarray) -> np.ndarray:
    """Unit vectors orthogonal to `normals` [N, 3]; of zero normals, x."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=-1)]
    across = _unit(np.cross(axis, normals))
    return np.where((across == 0).all(-1, keepdims=True), np.array([1.0, 0, 0]), across)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.divide(vector, length, out=np.zeros_like(vector), where=length > 1e-20)
