"""What counts in held-out views without masks where the training views have some: what shows the hull of these."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion

from exmesh_graph.geometry.grounded import hull_of
from exmesh_graph.geometry.hull import visual_hull
from exmesh_graph.masks.outlines import masks_of_surface
from exmesh_graph.types import Mesh, Views

_PARED = 2  # pixels taken off the rim: masks that are found err by one or two


def shown_by_masks(views: Views, train: Views, ground: Mesh | None = None) -> np.ndarray:
    """bool [N, H, W]: pixels of `views` that show what the masks of `train` have in common, above the `ground`.

    The hull is drawn into each view, cut to the picture's edges and pared. Nothing that is scored has a say. Raises
    DataError where the masks have no common shape.
    """
    vertices, faces = visual_hull(hull_of(train, ground), resolution=0)
    masks = masks_of_surface(views, vertices, faces)
    return np.stack([binary_erosion(mask, iterations=_PARED, border_value=1) for mask in masks])
