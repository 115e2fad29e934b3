"""Precomputed light transport of a frozen mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from exmesh_graph.types.artifact import ArrayArtifact
from exmesh_graph.types.mesh import Mesh

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class Transport(ArrayArtifact):
    """What K rays from each of P surface points met: the sky, or the mesh itself.

    directions   float32 [K, 3], equal-area unit directions
    steps        int32 [F], how many steps n the points make along each edge of a face; 1 = points at its corners only
    face_points  int32 [Q], the (n + 1)(n + 2) / 2 points of each face's lattice, face after face (shading.lattice)
    points       float32 [P, 3], normals float32 [P, 3] unit shading normals
    point_face   int32 [P], point_bary float32 [P, 3]: where on the mesh each point lies
    visible      uint8 [P, ceil(K / 8)], bit k (least significant first) = direction k is above the point's horizon
                 and sees the sky
    hit_point    int32 [B], hit_direction uint16 [B], hit_face int32 [B], hit_bary float32 [B, 2] (weights of the
                 face's second and third corner): front-facing hits of the rays that met the mesh
    bounces      interreflections to add to the direct light; 0 until transport.bounce
    deeper       whether the bounces beyond these count too (shading.operators)
    secondary_material  whether interreflection carries the colour of where it comes from
    gather_start, gather_point, gather_weight   the operator M of transport.bounce as CSR rows
                 (int32 [P + 1], int32 [Z], float32 [Z]), or None
    """

    type_name: ClassVar[str] = "Transport"
    conventions: ClassVar[Mapping[str, Any]] = Mesh.conventions
    layout: ClassVar[Mapping[str, str]] = {
        "directions": "float32 K 3", "steps": "int32 F", "face_points": "int32 Q", "points": "float32 P 3",
        "normals": "float32 P 3", "point_face": "int32 P", "point_bary": "float32 P 3",
        "visible": "uint8 P bytes", "hit_point": "int32 B",
        "hit_direction": "uint16 B", "hit_face": "int32 B", "hit_bary": "float32 B 2", "gather_start": "int32? rows",
        "gather_point": "int32? Z", "gather_weight": "float32? Z",
    }  # fmt: skip
    directions: np.ndarray
    steps: np.ndarray
    face_points: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    point_face: np.ndarray
    point_bary: np.ndarray
    visible: np.ndarray
    hit_point: np.ndarray
    hit_direction: np.ndarray
    hit_face: np.ndarray
    hit_bary: np.ndarray
    bounces: int = 0
    secondary_material: bool = True
    deeper: bool = False
    gather_start: np.ndarray | None = None
    gather_point: np.ndarray | None = None
    gather_weight: np.ndarray | None = None

    def facets(self) -> dict[str, Any]:
        return {"bounces": self.bounces}
