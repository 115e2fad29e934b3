"""A mesh in an order by place: what lies side by side on the surface lies side by side in memory.

Splits put what they make at the end of each list. Every pass over faces then gathers its corners from all over memory,
which on a mesh of 200 000 faces takes longer than the arithmetic. The order is that of Morton (1966, "A computer
oriented geodetic data base"): bits of the coordinates interleaved.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.topology import Step, Topology

_BITS = 10
"""Of each coordinate: cells of a thousandth of the mesh."""


def in_space_order(mesh: Topology) -> Topology:
    """The same mesh and atlas, its vertices, faces and UVs along the curve; equal cells keep their order."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if not len(faces):
        return mesh
    code = morton(vertices)
    by_vertex = np.argsort(code, kind="stable")
    # a UV stands where its last corner does; those of no face come first
    place = np.zeros(len(mesh.uvs), code.dtype)
    place[mesh.uv_faces.reshape(-1)] = code[faces.reshape(-1)]
    by_uv = np.argsort(place, kind="stable")
    by_face = np.argsort(morton(vertices[faces].mean(axis=1)), kind="stable")
    corners = [_renamed(part, order)[by_face] for part, order in ((faces, by_vertex), (mesh.uv_faces, by_uv))]
    return Topology(
        vertices[by_vertex], corners[0], mesh.uvs[by_uv], corners[1], mesh.map.then(Step(by_vertex)),
        mesh.face_source[by_face], mesh.count,
    )  # fmt: skip


def morton(points: np.ndarray) -> np.ndarray:
    """int64 [N]: the place of points [N, 3] on the curve through the cube around all of them."""
    low = points.min(axis=0)
    side = max(float((points.max(axis=0) - low).max()), 1e-30)
    cells = np.clip((points - low) / side * (1 << _BITS), 0, (1 << _BITS) - 1).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _renamed(corners: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Corners [F, 3] by the new numbers of what is put into `order`."""
    new = np.empty(len(order), corners.dtype)
    new[order] = np.arange(len(order), dtype=corners.dtype)
    return new[corners]
