"""The visual hull above a plane: what stands on a table does not go on below it, whatever cameras from above allow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exmesh_graph.geometry.hull import SilhouetteField, goes_on
from exmesh_graph.types import Mesh, Views

_FOUND_REACH = 1.4
"""Where masks were found, the world's sphere is a guess from points: a smooth part may lie outside."""


def hull_of(views: Views, ground: Mesh | None = None, wrong_masks: int = 0, *, found: bool = True) -> SilhouetteField:
    """The field of the masks of `views`, above a flat mesh where one is given; `found`: not by whom the world was made,
    so that it is looked for farther where it goes on beyond the usual cube. Raises as `SilhouetteField.of_views`."""
    field = SilhouetteField.of_views(views, wrong_masks)
    if ground is not None:
        field = Grounded.on(field, ground)
    return replace(field, reach=_FOUND_REACH) if found and goes_on(field) else field


@dataclass(frozen=True)
class Grounded(SilhouetteField):
    """The hull's field above the points x with normal . x = offset; the normal [3] is a unit vector."""

    normal: np.ndarray | None = None
    offset: float = 0.0

    @classmethod
    def above(cls, field: SilhouetteField, normal: np.ndarray, offset: float) -> Grounded:
        """`field` cut off below the plane."""
        return cls(
            field.distances, field.intrinsics, field.world_to_camera, field.wrong_masks, field.reach,
            np.asarray(normal, np.float64), offset,
        )  # fmt: skip

    @classmethod
    def on(cls, field: SilhouetteField, ground: Mesh) -> Grounded:
        """`field` cut off below a flat mesh that faces up."""
        corners = np.asarray(ground.vertices, np.float64)[np.asarray(ground.faces)]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
        normal = across / np.linalg.norm(across)
        return cls.above(field, normal, float((corners.reshape(-1, 3) @ normal).mean()))

    def __call__(self, points: np.ndarray, floor: float = -np.inf) -> np.ndarray:
        return np.minimum(super().__call__(points, floor), self._height(points))

    def plain(self, points: np.ndarray) -> np.ndarray:
        return np.minimum(super().plain(points), self._height(points))

    def _height(self, points: np.ndarray) -> np.ndarray:
        return (np.asarray(points, np.float64) @ np.asarray(self.normal) - self.offset).astype(np.float32)
