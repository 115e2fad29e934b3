"""Planar Gaussians and points: surfaces that are not meshes yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from exmesh_graph.types.artifact import ArrayArtifact

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class PlanarGaussians(ArrayArtifact):
    """G Gaussians flattened to planes, in the normalised Y-up world.

    means       float32 [G, 3]
    scales      float32 [G, 3], logarithms of the standard deviations; the smallest is the plane's thickness
    rotations   float32 [G, 4], quaternions (w, x, y, z)
    opacities   float32 [G], logits
    sh          float32 [G, K, 3], spherical harmonics of display colour less 1/2; K = 1, 4, 9 or 16
    """

    type_name: ClassVar[str] = "PlanarGaussians"
    conventions: ClassVar[Mapping[str, Any]] = {"up": "y", "units": "normalised", "color": "srgb"}
    layout: ClassVar[Mapping[str, str]] = {
        "means": "float32 G 3", "scales": "float32 G 3", "rotations": "float32 G 4", "opacities": "float32 G",
        "sh": "float32 G K 3",
    }  # fmt: skip
    means: np.ndarray
    scales: np.ndarray
    rotations: np.ndarray
    opacities: np.ndarray
    sh: np.ndarray

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True, eq=False)
class PointCloud(ArrayArtifact):
    """P points of the surface, as structure from motion finds them, in the normalised Y-up world.

    points   float32 [P, 3]
    colours  float32 [P, 3], display colour (sRGB) in [0, 1]
    """

    type_name: ClassVar[str] = "PointCloud"
    conventions: ClassVar[Mapping[str, Any]] = {"up": "y", "units": "normalised", "color": "srgb"}
    layout: ClassVar[Mapping[str, str]] = {"points": "float32 P 3", "colours": "float32 P 3"}
    points: np.ndarray
    colours: np.ndarray

    def __len__(self) -> int:
        return len(self.points)
