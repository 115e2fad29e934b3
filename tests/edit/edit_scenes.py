"""A ball with an atlas of its own under an uneven sky."""

import numpy as np

from exmesh_graph.geometry.shapes import icosphere
from exmesh_graph.types import Asset


def ball(size: int = 64, level: int = 2) -> Asset:
    """A unit ball; its faces lie in a grid of cells in the atlas."""
    vertices, faces = icosphere(level)
    cells = int(np.ceil(np.sqrt(len(faces))))
    row, column = np.divmod(np.arange(len(faces)), cells)
    corner = np.stack([column, row], axis=-1)[:, None] + np.array([[0.05, 0.05], [0.95, 0.05], [0.05, 0.95]])
    environment = np.full((16, 32, 3), 0.3, np.float32)
    environment[4:8, :8] = 3.0
    rng = np.random.default_rng(0)
    return Asset(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        uvs=(corner.reshape(-1, 2) / cells).astype(np.float32),
        uv_faces=np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3),
        texture=np.full((size, size, 3), 0.5, np.float32),
        base_color=rng.uniform(0.4, 0.6, (size, size, 3)).astype(np.float32),
        roughness=rng.uniform(0.4, 0.6, (size, size)).astype(np.float32),
        seen=np.ones((size, size), bool),
        environment=environment,
    )
