"""The geometry of an exported asset: points in scene units, smooth normals, what the mesh is like."""

from __future__ import annotations

from typing import Any

import numpy as np

from exmesh_graph.io.usd_checks import check_frame
from exmesh_graph.types import Asset, Frame


def scene_geometry(asset: Asset, frame: Frame | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    """(points float32 [V, 3], unit normals float32 [V, 3], rotation [3, 3], report): x -> s R x + t.

    Without a frame the points stay in normalised units. An unknown scale is exported as one metre per unit and
    says so in the report.
    """
    from exmesh_graph.geometry.adjacency import angle_weighted_normals  # the very normals that Stage II shaded with

    normals = angle_weighted_normals(asset.vertices, asset.faces)
    normals[~normals.any(axis=1)] = [0.0, 1.0, 0.0]  # vertices without any area around them still need a unit normal
    points, rotation = asset.vertices.astype(np.float64), np.eye(3)
    report: dict[str, Any] = {
        "metres_per_unit": 1.0,
        "scale": "normalised",
        "scene_units_per_normalised": 1.0,
    }
    if frame is not None:
        rotation, size = check_frame(frame)
        matrix = np.asarray(frame.scene_from_normalised, np.float64)
        points = points @ matrix[:3, :3].T + matrix[:3, 3]
        normals = normals @ rotation.T
        known = frame.metres_per_unit > 0
        report = {
            "metres_per_unit": float(frame.metres_per_unit) if known else 1.0,
            "scale": "measured" if known else "unknown",
            "scene_units_per_normalised": size,
            "scene_from_normalised": matrix.tolist(),
        }
    return points.astype(np.float32), normals.astype(np.float32), rotation, report


def mesh_report(asset: Asset) -> dict[str, Any]:
    """Counts of what matters to a user of the mesh; signed texture area < 0 marks a mirrored face."""
    corner = asset.uvs.astype(np.float64)[asset.uv_faces]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    facets = asset.facets()
    return {
        "faces": len(asset.faces),
        "vertices": len(asset.vertices),
        "closed": bool(facets["closed"]),
        "manifold": bool(facets["manifold"]),
        "mirrored_uv_faces": int((area < 0).sum()),
        "degenerate_uv_faces": int((area == 0).sum()),
    }
