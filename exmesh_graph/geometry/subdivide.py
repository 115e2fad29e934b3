"""Uniform refinement: every face into four at its edge midpoints."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.maps import Step, VertexMap
from exmesh_graph.geometry.split import Topology
from exmesh_graph.types.edges import edges_of


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
        _four(faces, edges.face_edges + len(vertices)),
        np.concatenate([uvs, middle]),
        _four(uv_faces, uv_edges.face_edges + len(uvs)),
        VertexMap((step,)),
        np.tile(np.arange(len(faces)), 4),
        len(faces),
    )


def _four(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    a, b, c = corners.T
    ab, bc, ca = middles.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts]).astype(corners.dtype)
