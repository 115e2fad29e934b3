"""Simple triangle meshes, counter-clockwise seen from outside: (vertices float32 [V, 3], faces int32 [F, 3])."""

from __future__ import annotations

import numpy as np

from exmesh_graph.types.edges import edges_of


def icosphere(levels: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of 20 * 4**levels faces about the origin."""
    phi = (1.0 + 5.0**0.5) / 2.0
    signs = [(a, b * phi) for b in (1.0, -1.0) for a in (-1.0, 1.0)]
    points = [(a, b, 0.0) for a, b in signs] + [(0.0, a, b) for a, b in signs] + [(b, 0.0, a) for a, b in signs]
    vertices = np.array(points)
    # Faces of the icosahedron: the triples of vertices at mutual distance 2, turned outwards.
    near = np.abs(np.linalg.norm(vertices[:, None] - vertices[None], axis=2) - 2.0) < 1e-9
    triples = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[k, i]
    ]
    faces = np.array(triples)
    inward = np.linalg.det(vertices[faces]) < 0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    for _ in range(levels):
        edges = edges_of(faces)
        middle = edges.face_edges + len(vertices)
        vertices = np.concatenate([vertices, vertices[edges.vertices].mean(axis=1)])
        (a, b, c), (ab, bc, ca) = faces.T, middle.T
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices *= radius / np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices.astype(np.float32), faces.astype(np.int32)
