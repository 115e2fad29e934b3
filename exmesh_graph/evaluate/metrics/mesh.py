"""Mesh figures: Chamfer distance to exact triangles, and what is sound or not about a mesh."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.geometry.adjacency import euler_characteristic, face_areas, face_normals, signed_volume
from exmesh_graph.geometry.clean import face_components
from exmesh_graph.geometry.soundness import inspect
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.native import import_pymeshlab
from exmesh_graph.types.edges import edges_of


@dataclass(frozen=True)
class Chamfer:
    """Distances between two surfaces, in the units of the vertices (un-squared).

    chamfer   mean of the two directions' means
    accuracy  mean distance from samples of the mesh to the true surface;  completeness  the other way
    p95, max  over the samples of both directions
    """

    chamfer: float
    accuracy: float
    completeness: float
    p95: float
    max: float
    samples: int

    def scaled(self, factor: float) -> dict[str, float | int]:
        """The figures times `factor` (1 / bounding_radius for a figure that does not depend on the scene's scale)."""
        return {k: v if k == "samples" else v * factor for k, v in asdict(self).items()}


def chamfer(
    vertices: np.ndarray,
    faces: np.ndarray,
    true_vertices: np.ndarray,
    true_faces: np.ndarray,
    *,
    samples: int = 40_000,
    seed: int = 0,
) -> Chamfer:
    """Chamfer distance by `samples` seeded, area-stratified points on each surface, to the other's exact triangles.

    Raises GeometryError for meshes without area.
    """
    from_mesh, _, _ = sample_surface(vertices, faces, samples, seed)
    from_truth, _, _ = sample_surface(true_vertices, true_faces, samples, seed + 1)
    forward = distance_to_mesh(from_mesh, true_vertices, true_faces)
    backward = distance_to_mesh(from_truth, vertices, faces)
    both = np.concatenate([forward, backward])
    accuracy, completeness = float(forward.mean()), float(backward.mean())
    return Chamfer(
        chamfer=(accuracy + completeness) / 2,
        accuracy=accuracy,
        completeness=completeness,
        p95=float(np.percentile(both, 95)),
        max=float(both.max()),
        samples=samples,
    )


def bounding_radius(vertices: np.ndarray) -> float:
    """Largest distance of a vertex from the middle of the axis-aligned bounding box."""
    if len(vertices) == 0:
        raise GeometryError("a mesh without vertices has no radius")
    points = vertices.astype(np.float64)
    middle = (points.min(0) + points.max(0)) / 2
    return float(np.linalg.norm(points - middle, axis=1).max())


def mesh_report(vertices: np.ndarray, faces: np.ndarray, *, self_intersections: bool = False) -> dict[str, Any]:
    """Counts and properties of a mesh, JSON-like.

    `genus` is the sum over the parts, (2 parts - Euler number) / 2, for closed manifolds only, else None. `folded` is
    the share of edges whose faces turn by more than 150 degrees. `self_intersections` asks pymeshlab for the number of
    faces that cut others.
    """
    soundness = inspect(vertices, faces)
    parts = int(face_components(faces, len(vertices)).max()) + 1 if len(faces) else 0
    euler = euler_characteristic(faces)
    manifold = soundness.crowded_edges == 0 and soundness.turned_edges == 0
    solid = soundness.closed and manifold and soundness.pinched_vertices == 0
    report: dict[str, Any] = {
        "vertices": len(vertices),
        "faces": len(faces),
        "components": parts,
        "closed": soundness.closed,
        "edge_manifold": manifold,
        "euler": int(euler),
        "genus": (2 * parts - int(euler)) // 2 if solid else None,
        "area": float(face_areas(vertices, faces).sum()),
        "volume": signed_volume(vertices, faces) if soundness.closed else None,
        "folded": folded_share(vertices, faces),
        **asdict(soundness),
    }
    if self_intersections:
        report["self_intersections"] = count_self_intersections(vertices, faces)
    return report


def folded_share(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Share of the edges with two faces at which the surface turns by more than 150 degrees."""
    edges = edges_of(faces)
    left, right = edges.faces[edges.interior].T
    if len(left) == 0:
        return 0.0
    normals = face_normals(vertices, faces)
    cosine = np.einsum("ei,ei->e", normals[left], normals[right])
    return float((cosine < np.cos(np.radians(150))).mean())


def count_self_intersections(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Number of faces that cut another face (pymeshlab)."""
    pymeshlab = import_pymeshlab()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices.astype(np.float64), faces.astype(np.int32)))
    meshes.compute_selection_by_self_intersections_per_face()
    return int(meshes.current_mesh().selected_face_number())
