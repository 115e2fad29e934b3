"""Patches of a surface: parts of like size, however fine its faces are."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import face_normals


def patches(vertices: np.ndarray, faces: np.ndarray, cells: int) -> np.ndarray:
    """int [F], from 0 on without gaps: faces of one patch lie in one cell of a grid, `cells` along the longest side of
    the surface, and face the same of six ways. A face larger than a cell is a patch of its own."""
    corners = np.asarray(vertices, np.float64)
    middle, normal = corners[faces].mean(1), face_normals(corners, faces)
    side = max(float(np.ptp(middle, axis=0).max(initial=0)), 1e-30)
    cell = ((middle - middle.min(0, initial=np.inf)) / side * (cells - 1e-6)).astype(np.int64)
    axis = np.abs(normal).argmax(1)
    way = 2 * axis + (np.take_along_axis(normal, axis[:, None], 1)[:, 0] > 0)
    return np.unique(np.column_stack([cell, way]), axis=0, return_inverse=True)[1].reshape(-1)
