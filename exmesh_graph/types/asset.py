"""Materials, light and the finished asset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from exmesh_graph.types.artifact import ArrayArtifact
from exmesh_graph.types.mesh import Carrier

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class EnvMap(ArrayArtifact):
    """Lat-long environment on the Y-up world, OpenEXR convention: image centre +Z, u = 0.25 is +X, row 0 is +Y.

    radiance  float32 [H, W, 3], linear, >= 0
    """

    type_name: ClassVar[str] = "EnvMap"
    conventions: ClassVar[Mapping[str, Any]] = {"environment": "openexr", "up": "y", "color": "linear"}
    layout: ClassVar[Mapping[str, str]] = {"radiance": "float32 H W 3"}
    radiance: np.ndarray


@dataclass(frozen=True, eq=False)
class Asset(Carrier):
    """The paper's frozen carrier with its UV-PBR maps and the recovered environment (Theta = {A, R, N, E}).

    base_color   float32 [R, R, 3], linear, in [0, 1]
    roughness    float32 [R, R]
    normal       float32 [R, R, 3], unit tangent-space normals (+Y up), or None when not modelled
    metallic     float32 [R, R], or None when not modelled
    seen         bool [R, R], texels that the training views saw well enough to be fitted; the others are filled
    environment  float32 [H, W, 3], as EnvMap.radiance
    confidence   float32 [R, R] in [0, 1), how much the training views tell of a texel (stage2.result), 0 where it was
                 filled; None when not known
    light_axis   float32 [3]: the axis that the environment turns about with the camera, as lamps beside a turntable do,
                 or zeros where it is fixed to the camera (shading.moving has its frame); None when it stands still
    """

    type_name: ClassVar[str] = "Asset"
    conventions: ClassVar[Mapping[str, Any]] = {**Carrier.conventions, "maps": "linear", "environment": "openexr"}
    layout: ClassVar[Mapping[str, str]] = {
        **Carrier.layout, "base_color": "float32 height width 3", "roughness": "float32 height width",
        "seen": "bool height width", "environment": "float32 H W 3", "normal": "float32? height width 3",
        "metallic": "float32? height width", "confidence": "float32? height width",
        "light_axis": "float32? 3",
    }  # fmt: skip
    base_color: np.ndarray
    roughness: np.ndarray
    seen: np.ndarray
    environment: np.ndarray
    normal: np.ndarray | None = None
    metallic: np.ndarray | None = None
    confidence: np.ndarray | None = None
    light_axis: np.ndarray | None = None
