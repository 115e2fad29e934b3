"""What an export holds once it is in scene units, checked and quantised: meshes, maps, cameras, light's turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

LODS = ("high", "mid", "low")


@dataclass(frozen=True, eq=False)
class MeshContent:
    """points, normals float32 [V, 3]; faces int32 [F, 3]; st float32 [T, 2] (v up, distinct); st_faces int32 [F, 3]"""

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    st: np.ndarray
    st_faces: np.ndarray

    @property
    def extent(self) -> np.ndarray:
        """float32 [2, 3], the corners of the bounding box."""
        return np.stack([self.points.min(0), self.points.max(0)])


@dataclass(frozen=True, eq=False)
class CameraContent:
    """One capture camera. `name` is a prim name, `view` what the data set calls it.

    matrix      float64 [4, 4], camera to world, scene units, rigid; OpenGL axes (x right, y up, looks along -z)
    intrinsics  float64 [3, 3], pixels of a `width` x `height` picture
    near, far   what the clipping range spans, scene units
    """

    name: str
    view: str
    matrix: np.ndarray
    intrinsics: np.ndarray
    width: int
    height: int
    near: float
    far: float


@dataclass(frozen=True, eq=False)
class AssetContent:
    """Everything that the layers need.

    meshes    by level of detail, finest first; the first is "high"
    files     level of detail -> map name (base_color, roughness, normal, metallic) -> file below textures/
    rotation  float64 [3, 3], the stage's world against the environment's: light from d is E(rotation^T d)
    """

    name: str
    meshes: Mapping[str, MeshContent]
    files: Mapping[str, Mapping[str, str]]
    metres_per_unit: float
    up_axis: str
    rotation: np.ndarray
    cameras: tuple[CameraContent, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def maps(self) -> tuple[str, ...]:
        """Names of the maps; all levels of detail have the same ones."""
        return tuple(sorted(self.files["high"]))
