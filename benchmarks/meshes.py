"""Simple meshes for tests and benchmarks, what is asked of a mesh there, and mesh files.

Shapes are counter-clockwise seen from outside: (vertices float32 [V, 3], faces int32 [F, 3]).
"""

from pathlib import Path

import numpy as np

from exmesh_graph.geometry.adjacency import corner_fans
from exmesh_graph.types.edges import Edges, edges_of, is_edge_manifold


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


def is_vertex_manifold(faces: np.ndarray) -> bool:
    """Whether the faces around every vertex form a single fan (a disc, or a half disc on a boundary)."""
    if not is_edge_manifold(faces):
        return False
    fans, _ = corner_fans(faces)
    return int(fans.max(initial=-1)) + 1 == len(np.unique(faces))


def is_winding_consistent(faces: np.ndarray, edges: Edges | None = None) -> bool:
    """Whether the two faces of every interior edge run along it in opposite directions."""
    edges = edges_of(faces) if edges is None else edges
    start = faces.reshape(-1)[edges.halfedges[edges.interior]]
    return bool((start[:, 0] != start[:, 1]).all())


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a binary little-endian PLY: float32 positions, int32 triangles."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    table = np.empty(len(faces), dtype=[("n", "u1"), ("v", "<i4", (3,))])
    table["n"], table["v"] = 3, faces
    Path(path).write_bytes(header.encode() + np.ascontiguousarray(vertices, "<f4").tobytes() + table.tobytes())


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write an OBJ with float32 positions (shortest decimals that read back exactly) and triangles."""
    lines = [f"v {x!s} {y!s} {z!s}" for x, y, z in np.asarray(vertices, np.float32)]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in np.asarray(faces).tolist()]
    Path(path).write_text("\n".join(lines) + "\n", encoding="ascii")
