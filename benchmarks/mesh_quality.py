"""Figures on the shape of a mesh's triangles: angles, edge lengths, slivers, degrees."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry.adjacency import edge_lengths, vertex_degrees
from exmesh_graph.geometry.topology import degeneracy
from exmesh_graph.types.edges import edges_of


def corner_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float64 [F, 3], radians; 0 where a corner has a side without length."""
    p = vertices[faces].astype(np.float64)
    u, v = np.roll(p, -1, axis=1) - p, np.roll(p, -2, axis=1) - p
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), np.einsum("fki,fki->fk", u, v))


def mesh_quality(vertices: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Named figures: counts, edge lengths (mean, spread), smallest angles (degrees), slivers, degrees."""
    edges = edges_of(faces)
    length = edge_lengths(vertices, edges)
    smallest = np.degrees(corner_angles(vertices, faces).min(axis=1))
    shape = degeneracy(vertices, faces)
    degree = vertex_degrees(faces, len(vertices), edges)
    degree = degree[degree > 0]
    return {
        "vertices": len(degree),
        "faces": len(faces),
        "edge_mean": float(length.mean()),
        "edge_cv": float(length.std() / max(length.mean(), 1e-300)),
        "min_angle_mean": float(smallest.mean()),
        "min_angle_p1": float(np.percentile(smallest, 1)),
        "degeneracy_p1": float(np.percentile(shape, 1)),
        "slivers": float((shape < 0.05).mean()),
        "degree_max": int(degree.max()),
        "degree_std": float(degree.std()),
    }
