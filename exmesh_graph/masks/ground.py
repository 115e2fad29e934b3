"""The object by what it hides of the ground: for surfaces that stereo does not see, or sees elsewhere.

A mirror, a glaze or bare plaster has no depth of its own that views agree on. The table that it stands on often has.
Where a view measures the table's depth there is no object; where it would see the table and does not, there may be one.
The shape that these outlines have in common, above the table, is closed and rough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.adjacency import face_areas
from exmesh_graph.geometry.clean import largest_components
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.masks.plane import Plane
from exmesh_graph.masks.standing import SHOWN, Standing, shown_by
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.types import DepthMaps, Views

_OUTVOTED = 0.05
_SUPPORT, _FEWEST = 0.2, 3
_CLOSED = 1


def object_on_ground(views: Views, depths: DepthMaps, plane: Plane, thick: float, least_part: float) -> Standing:
    """What hides the table `plane`, known to `thick`, from `views` that measure `depths` of it; closed.

    A point above the table belongs to it if hardly a view (one of twenty) measures the table behind it, and a fifth of
    them, three at least, miss the table there. Views that look past the table's part in the unit sphere have no say.
    `apart` is the share of its surface that 80 % of the pictures hold, inside that sphere.
    Raises GeometryError where the plane is no table, and where nothing hides it.
    """
    if not plane.is_table:
        raise GeometryError("the plane that was found does not go on beside an object", where="masks.ground")
    hidden, open_ = _outlines(views, depths, plane, thick)
    telling = np.flatnonzero(hidden.any(axis=(1, 2)))
    support = max(_FEWEST, round(_SUPPORT * len(views)))
    if len(telling) < max(support, 2):
        raise GeometryError(f"{len(telling)} views show something that hides the table", where="masks.ground",
                            expected=f"{support} or more")  # fmt: skip
    cameras = views.intrinsics, views.world_to_camera
    most = SilhouetteField.from_masks(
        hidden[telling], *(part[telling] for part in cameras), wrong_masks=len(telling) - support
    )
    wrong = min(max(1, round(_OUTVOTED * len(views))), len(views) - 1)
    all_ = SilhouetteField.from_masks(hidden | open_, *cameras, wrong_masks=wrong)
    field = _Hiding(all_.distances, all_.intrinsics, all_.world_to_camera, wrong, most, plane)
    vertices, faces = largest_components(*visual_hull(field, resolution=0), 0, least_part)
    area = face_areas(vertices, faces)
    whole = (shown_by(vertices, views) >= SHOWN) & (np.linalg.norm(vertices, axis=1) < 1)
    return Standing(vertices, faces, plane, True, {}, float(area[whole[faces].all(axis=1)].sum() / area.sum()))


def _outlines(views: Views, depths: DepthMaps, plane: Plane, thick: float) -> tuple[np.ndarray, np.ndarray]:
    """bool [N, H, W] each: where a view would see the table in the unit sphere and does not; where it looks past it."""
    import torch

    hidden, past = (np.zeros((len(views), views.height, views.width), bool) for _ in range(2))
    like = torch.zeros(1, dtype=torch.float64)
    for i, pose in enumerate(views.camera_to_world):
        rays = pixel_rays(torch.from_numpy(views.intrinsics[i]), views.height, views.width, like).numpy()
        rays, eye = rays @ pose[:3, :3].T, pose[:3, 3]
        down = rays @ plane.normal
        meets = np.where(down < -1e-6, -plane.height(eye) / np.minimum(down, -1e-6), 0)
        on = (meets > 0) & (np.linalg.norm(eye + meets[..., None] * rays, axis=-1) < 1)
        depth = depths.depth[i]
        table = (depth > 0) & (np.abs(plane.height(eye + depth[..., None] * rays)) < thick)
        closed = binary_closing(np.pad(table, _CLOSED), iterations=_CLOSED)[_CLOSED:-_CLOSED, _CLOSED:-_CLOSED]
        table |= closed
        hidden[i], past[i] = on & ~table, ~on
    return hidden, past


@dataclass(frozen=True)
class _Hiding(SilhouetteField):
    """The hull's field of points that enough views find `hidden` in, above the plane."""

    hidden: SilhouetteField | None = None
    plane: Plane | None = None

    def __call__(self, points: np.ndarray, floor: float = -np.inf) -> np.ndarray:
        assert self.hidden is not None
        assert self.plane is not None
        both = np.minimum(super().__call__(points, floor), self.hidden(points, floor))
        return np.minimum(both, self.plane.height(points).astype(np.float32))
