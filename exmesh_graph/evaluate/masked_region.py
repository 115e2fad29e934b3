"""What counts in held-out views without masks where the training views have some: what shows the hull of these."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import binary_erosion

from exmesh_graph.geometry.grounded import hull_of
from exmesh_graph.geometry.hull import visual_hull
from exmesh_graph.masks.outlines import masks_of_surface
from exmesh_graph.raster.camera import pixel_rays
from exmesh_graph.rays import make_ray_tracer
from exmesh_graph.types import Mesh, Views

_PARED = 2  # pixels taken off the rim: masks that are found err by one or two
_BEYOND = 10.0  # units behind the origin: no hull reaches that far


class Shown(NamedTuple):
    """inside bool [N, H, W]; start, end float32 [N, H, W]: depths at which a pixel's ray enters and leaves the hull."""

    inside: np.ndarray
    start: np.ndarray
    end: np.ndarray


def shown_by_masks(views: Views, train: Views, ground: Mesh | None = None) -> Shown:
    """Pixels of `views` that show what the masks of `train` have in common, above the `ground`, and how deep that is.

    The hull is drawn into each view, cut to the picture's edges and pared. Nothing that is scored has a say. Raises
    DataError where the masks have no common shape.
    """
    vertices, faces = visual_hull(hull_of(train, ground), resolution=0)
    masks = masks_of_surface(views, vertices, faces)
    inside = np.stack([binary_erosion(mask, iterations=_PARED, border_value=1) for mask in masks])
    start, end = (np.zeros(inside.shape, np.float32) for _ in range(2))
    tracer = make_ray_tracer(vertices, faces)
    for i, one in enumerate(inside):
        rays, place = pixel_directions(views, i)[one], views.camera_to_world[i][:3, 3]
        far = np.linalg.norm(place) + _BEYOND
        first = tracer.closest_hit(np.broadcast_to(place, rays.shape), rays).t
        last = far - tracer.closest_hit(place + far * rays, -rays).t
        hit = np.isfinite(first)
        start[i][one], end[i][one] = np.where(hit, first, 0), np.where(hit, last, 0)
    return Shown(inside & (end > start), start, end)


def pixel_directions(views: Views, view: int) -> np.ndarray:
    """float64 [H, W, 3] in the world, of depth 1."""
    k, like = torch.from_numpy(views.intrinsics[view]), torch.zeros(1, dtype=torch.float64)
    return pixel_rays(k, views.height, views.width, like).numpy() @ views.camera_to_world[view][:3, :3].T
