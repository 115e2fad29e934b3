"""Triangle meshes, the mesh-UV carrier of the paper's Stage I, and Stage I's running state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from exmesh_graph.types.artifact import ArrayArtifact

if TYPE_CHECKING:
    import numpy as np


NORMALISED_REACH = 2.0  # objects lie in the unit sphere; a surface under refinement may stray


@dataclass(frozen=True, eq=False)
class Mesh(ArrayArtifact):
    """A triangle mesh M = (V, F) in the normalised Y-up world, counter-clockwise seen from outside.

    vertices  float32 [V, 3]
    faces     int32 [F, 3]
    """

    type_name: ClassVar[str] = "Mesh"
    conventions: ClassVar[Mapping[str, Any]] = {"up": "y", "units": "normalised"}
    layout: ClassVar[Mapping[str, str]] = {"vertices": "float32 V 3", "faces": "int32 F 3"}
    indices: ClassVar[Mapping[str, str]] = {"faces": "vertices"}
    vertices: np.ndarray
    faces: np.ndarray

    def facets(self) -> dict[str, Any]:
        from exmesh_graph.types.edges import is_closed, is_edge_manifold

        reach = float((self.vertices.astype("float64") ** 2).sum(axis=1).max(initial=0.0)) ** 0.5
        units = "normalised" if reach <= NORMALISED_REACH else "unknown"
        return {
            "manifold": is_edge_manifold(self.faces), "closed": is_closed(self.faces), "uv": False, "units": units,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Carrier(Mesh):
    """Mesh, UV atlas and RGB texture: (V, F), (U, Phi) and T_rgb of the paper's section 4.

    uvs       float32 [T, 2], origin lower left, v up, in [0, 1]
    uv_faces  int32 [F, 3], the face-corner-to-UV index map Phi
    texture   float32 [R, R, 3], sRGB-encoded appearance, row 0 is v = 1, texel centres at (i + 0.5) / R
    """

    type_name: ClassVar[str] = "Carrier"
    conventions: ClassVar[Mapping[str, Any]] = {**Mesh.conventions, "uv": True, "color": "srgb"}
    layout: ClassVar[Mapping[str, str]] = {
        **Mesh.layout, "uvs": "float32 T 2", "uv_faces": "int32 F 3|0 3", "texture": "float32 R R 3",
    }  # fmt: skip
    indices: ClassVar[Mapping[str, str]] = {**Mesh.indices, "uv_faces": "uvs"}
    uvs: np.ndarray
    uv_faces: np.ndarray
    texture: np.ndarray

    def facets(self) -> dict[str, Any]:
        return {**super().facets(), "uv": len(self.uvs) > 0 and self.uv_faces.shape == self.faces.shape}


@dataclass(frozen=True, eq=False)
class Stage1State(Carrier):
    """A carrier in the middle of Stage I: optimiser moments and the gradient EMA of eq. 1 travel with it.

    vertex_m, vertex_v    float32 [V, 3] and [V], Adam's first moment and the per-vertex second moment
    texture_m, texture_v  float32 [R, R, 3]
    gradient_ema          float32 [V], eq. 1
    iteration             iterations done since stage1.init
    vertex_steps, texture_steps  Adam's step counts (bias correction)
    appearance            the model that is fitted: "uv_texture" (the texture itself), "directional" (the texture and a
                          residual beside it), "per_vertex", "per_face", "mlp"
    model                 a model's arrays: `values`, Adam's `m` and `v` ([V, 3], [F, 3], the weights [P], or the
                          residual [V, 3 K] with v [V]), and what else it needs; empty for "uv_texture". `texture` then
                          holds the model as last baked, or the model's mean over the views
    """

    type_name: ClassVar[str] = "Stage1State"
    layout: ClassVar[Mapping[str, str]] = {
        **Carrier.layout, "vertex_m": "float32 V 3", "vertex_v": "float32 V", "gradient_ema": "float32 V",
        "texture_m": "float32 R R 3", "texture_v": "float32 R R 3",
    }  # fmt: skip
    vertex_m: np.ndarray
    vertex_v: np.ndarray
    texture_m: np.ndarray
    texture_v: np.ndarray
    gradient_ema: np.ndarray
    iteration: int = 0
    vertex_steps: int = 0
    texture_steps: int = 0
    appearance: str = "uv_texture"
    model: Mapping[str, np.ndarray] = field(default_factory=dict)

    def carried(self, topology: Any) -> Self:
        """This state on the mesh and atlas that an operation made of its own (geometry.split.Topology): moments and
        gradients follow their vertices, a model's colours their vertices or faces; texture and step counts stay.
        """
        follow: Callable[[np.ndarray], np.ndarray] = topology.map.carry
        model = self.model
        if self.appearance == "per_vertex":
            model = {name: follow(array) for name, array in model.items()}
        if self.appearance == "directional":
            model = {name: array if name == "settings" else follow(array) for name, array in model.items()}
        if self.appearance == "per_face":
            model = {name: array[topology.face_source] for name, array in model.items()}
        return replace(
            self,
            vertices=topology.vertices,
            faces=topology.faces,
            uvs=topology.uvs,
            uv_faces=topology.uv_faces,
            vertex_m=follow(self.vertex_m),
            vertex_v=follow(self.vertex_v),
            gradient_ema=follow(self.gradient_ema),
            model=model,
        )
