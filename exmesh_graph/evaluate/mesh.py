"""Scoring a mesh against the true surface."""

from __future__ import annotations

from typing import Any

from exmesh_graph.types import Mesh, SceneTruth


def score_mesh(mesh: Mesh, truth: SceneTruth | None = None, *, samples: int = 40_000, seed: int = 0) -> dict[str, Any]:
    """Counts, soundness and, with a true mesh, Chamfer distances in thousandths of its bounding radius."""
    from exmesh_graph.evaluate.metrics.mesh import bounding_radius, chamfer, mesh_report

    sound = mesh_report(mesh.vertices, mesh.faces)
    headline: list[dict[str, Any]] = []
    values: dict[str, Any] = {"headline": headline, "mesh": sound}
    if truth is not None and truth.mesh_vertices is not None and truth.mesh_faces is not None:
        radius = bounding_radius(truth.mesh_vertices)
        distance = chamfer(mesh.vertices, mesh.faces, truth.mesh_vertices, truth.mesh_faces, samples=samples, seed=seed)
        values["chamfer_per_mille_of_radius"] = distance.scaled(1000.0 / radius)
        values["bounding_radius"] = radius
        headline.append(
            {
                "label": "Chamfer",
                "value": values["chamfer_per_mille_of_radius"]["chamfer"],
                "unit": "‰ of radius",
                "better": "lower",
                "series": "Chamfer",
                "over": {"vertices": int(sound["vertices"])},
            }
        )
    headline.append({"label": "Closed", "value": bool(sound["closed"])})
    headline.append({"label": "Manifold", "value": bool(sound["edge_manifold"] and not sound["pinched_vertices"])})
    headline.append({"label": "Faces", "value": int(sound["faces"])})
    headline.append({"label": "Vertices", "value": int(sound["vertices"])})
    return values
