"""Small parts of a start: which of them the masks need, and which are what the masks fail to rule out."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.geometry.adjacency import face_areas, without_unused
from exmesh_graph.geometry.clean import face_components
from exmesh_graph.gpu.cores import share
from exmesh_graph.raster import shown_faces
from exmesh_graph.types import Views

_PIXELS = 4
"""A mask's rim leaves a pixel or two bare; a part that is needed shows more."""
_VIEWS = 2


def without_phantoms(
    vertices: np.ndarray, faces: np.ndarray, views: Views, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """The mesh (vertices [V, 3], faces [F, 3]) without the connected parts that no mask needs.

    A part below `least` of the largest one's area stays if in at least two views it covers at least four pixels of the
    mask that no larger part covers: a leaf on a stem that the masks lost does, a phantom in a corner that all cones
    share does not, for it lies before or behind what they show. Raises DataError for views without masks.
    """
    if not views.masked.all():
        raise DataError("parts are judged by masks, and not every view has one", where="parts of the start")
    labels = face_components(faces, len(vertices))
    area = np.bincount(labels, face_areas(vertices, faces))
    kept = area >= least * area.max(initial=0)
    if kept.all():
        return vertices, faces
    large = kept[labels]

    def needs(view: int) -> np.ndarray:
        bare = (views.alpha[view] > 0.5) & (_seen(vertices, faces[large], views, view) < 0)
        small = _seen(vertices, faces[~large], views, view)
        here = labels[~large][small[bare & (small >= 0)]]
        return np.bincount(here, minlength=len(area)) >= _PIXELS

    kept |= np.sum(share(needs, range(len(views))), axis=0) >= _VIEWS
    return without_unused(vertices, faces[kept[labels]].astype(np.int32))


def _seen(vertices: np.ndarray, faces: np.ndarray, views: Views, view: int) -> np.ndarray:
    """Index int32 [H, W] of the nearest of `faces`, -1 where there is none."""
    where = views.intrinsics[view], views.world_to_camera[view]
    return shown_faces(vertices, faces, *where, views.height, views.width)
