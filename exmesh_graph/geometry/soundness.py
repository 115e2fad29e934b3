"""What is wrong with a triangle mesh, counted, and the error that names it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import corner_fans, face_areas, signed_volume
from exmesh_graph.types.edges import edges_of


@dataclass(frozen=True)
class Soundness:
    """What is wrong with a mesh, counted; all zero (and `closed`, where it matters) for a sound one."""

    open_edges: int
    crowded_edges: int
    turned_edges: int
    pinched_vertices: int
    duplicate_faces: int
    flat_faces: int
    unreferenced: int

    @property
    def closed(self) -> bool:
        return self.open_edges == 0 and self.crowded_edges == 0


def inspect(vertices: np.ndarray, faces: np.ndarray) -> Soundness:
    """Count defects: see the fields of `Soundness`. Flat: area below 1e-12 of the mesh's bounding box squared."""
    edges = edges_of(faces)
    starts = faces.reshape(-1)[edges.halfedges[edges.interior]]
    _, fan_vertex = corner_fans(faces, edges)
    used = np.unique(faces)
    return Soundness(
        open_edges=int((edges.count == 1).sum()),
        crowded_edges=int((edges.count > 2).sum()),
        turned_edges=int((starts[:, 0] == starts[:, 1]).sum()),
        pinched_vertices=int((np.bincount(fan_vertex, minlength=1) > 1).sum()),
        duplicate_faces=len(faces) - len(np.unique(np.sort(faces, axis=1), axis=0)),
        flat_faces=int((face_areas(vertices, faces) <= flat_area(vertices)).sum()),
        unreferenced=len(vertices) - len(used),
    )


def flat_area(vertices: np.ndarray) -> float:
    """The area at which a face counts as flat."""
    return 1e-12 * float(np.ptp(vertices, axis=0).max()) ** 2 if len(vertices) else 1e-12


def require_sound(vertices: np.ndarray, faces: np.ndarray, *, closed: bool, where: str) -> None:
    """GeometryError naming the defects unless the mesh is edge-manifold, oriented and free of useless parts.

    With `closed` it must also be closed and enclose positive volume. Pinched vertices are allowed.
    """
    counted = inspect(vertices, faces)
    defects = {
        "edges with more than two faces": counted.crowded_edges,
        "edges whose faces turn against each other": counted.turned_edges,
        "duplicate faces": counted.duplicate_faces,
        "faces without area": counted.flat_faces,
        "vertices without a face": counted.unreferenced,
        "open edges": counted.open_edges if closed else 0,
    }
    named = [f"{count} {what}" for what, count in defects.items() if count]
    if not np.isfinite(vertices).all():
        named.append("vertices that are NaN or Inf")
    if closed and not named and signed_volume(vertices, faces) <= 0:
        named.append("faces that look inwards")
    if named:
        raise GeometryError(
            "the mesh is not sound: " + ", ".join(named), where=where,
            expected="an edge-manifold, oriented mesh" + (", closed" if closed else ""),
            fix="try the other `method`, another face budget, or a cleaner input mesh",
        )  # fmt: skip
