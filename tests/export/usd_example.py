"""A small asset for the USD tests: an octahedron, every face a chart of its own, maps without symmetry."""

import numpy as np

from exmesh_graph.types import Asset

SIZE = 32


def example_asset(**changes) -> Asset:
    """A closed octahedron with 8 charts in a 4 x 2 grid, 32 x 32 maps, a 8 x 16 environment."""
    rng = np.random.default_rng(7)
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32) * 0.8
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32)
    corner = np.array([[0.15, 0.15], [0.85, 0.15], [0.15, 0.85]])
    cells = [((k % 4) / 4, (k // 4) / 2) for k in range(8)]
    uvs = np.concatenate([corner * [0.25, 0.5] + cell for cell in cells]).astype(np.float32)
    values = {
        "vertices": vertices,
        "faces": faces,
        "uvs": uvs,
        "uv_faces": np.arange(24, dtype=np.int32).reshape(8, 3),
        "texture": np.zeros((SIZE, SIZE, 3), np.float32),
        "base_color": rng.random((SIZE, SIZE, 3), np.float32),
        "roughness": 0.1 + 0.9 * rng.random((SIZE, SIZE), np.float32),
        "seen": np.ones((SIZE, SIZE), bool),
        "environment": 5 * rng.random((8, 16, 3), np.float32),
    }
    return Asset(**{**values, **changes})


def tilted_normals() -> np.ndarray:
    """Unit tangent-space normals float32 [SIZE, SIZE, 3], all above the surface."""
    rng = np.random.default_rng(11)
    normal = np.concatenate([rng.uniform(-0.6, 0.6, (SIZE, SIZE, 2)), np.ones((SIZE, SIZE, 1))], axis=-1)
    return (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)
