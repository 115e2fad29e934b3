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


def tetrahedron() -> tuple[np.ndarray, np.ndarray]:
    """Four faces, the smallest closed manifold."""
    vertices = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32)
    return vertices, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)


def torus(around: int, across: int, major: float = 1.0, minor: float = 0.4) -> tuple[np.ndarray, np.ndarray]:
    """2 * around * across faces; both counts at least 3."""
    u, v = np.meshgrid(
        np.arange(around) * 2.0 * np.pi / around, np.arange(across) * 2.0 * np.pi / across, indexing="ij"
    )
    ring = major + minor * np.cos(v)
    vertices = np.stack([ring * np.cos(u), minor * np.sin(v), -ring * np.sin(u)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")

    def at(di: int, dj: int) -> np.ndarray:
        return (((i + di) % around) * across + (j + dj) % across).reshape(-1)

    a, b, c, d = at(0, 0), at(1, 0), at(1, 1), at(0, 1)
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return vertices.astype(np.float32), faces.astype(np.int32)


def grid(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """The unit square in the plane y = 0, facing +Y, with a boundary; 2 * columns * rows faces."""
    x, z = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1), indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    a = (i * (rows + 1) + j).reshape(-1)
    b, c, d = a + rows + 1, a + rows + 2, a + 1
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])
    return vertices.astype(np.float32), faces.astype(np.int32)
