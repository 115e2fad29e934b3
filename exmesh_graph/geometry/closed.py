"""Closed surfaces of solids: of the visual hull, and of any field on a grid."""

from __future__ import annotations

import numpy as np

from exmesh_graph.geometry import hull
from exmesh_graph.geometry.adjacency import without_unused
from exmesh_graph.geometry.clean import largest_components, taubin, without_pillows
from exmesh_graph.geometry.repair import make_manifold
from exmesh_graph.geometry.settings import HullSettings
from exmesh_graph.geometry.soundness import require_sound

Arrays = tuple[np.ndarray, np.ndarray]


def hull_surface(field: hull.SilhouetteField, settings: HullSettings, where: str = "geometry.closed") -> Arrays:
    """(vertices [V, 3], faces [F, 3]) of the visual hull, smoothed. Raises GeometryError where it is not sound."""
    vertices, faces = hull.visual_hull(field, resolution=settings.resolution)
    vertices = taubin(vertices, faces, settings.smooth)
    require_sound(vertices, faces, closed=True, where=where)
    return vertices, faces


def solid_surface(values: np.ndarray, grid: hull.Grid, parts: int = 0, where: str = "geometry.closed") -> Arrays:
    """(vertices [V, 3], faces [F, 3]) where a field [I, J, K], positive inside, is 0; `parts` of it, largest area
    first, 0: all. Raises GeometryError where it is not sound."""
    vertices, faces = largest_components(*hull.surface(values, grid), parts)
    # where a carved field is 0 at corners of its grid the surface touches itself
    vertices, faces = make_manifold(*without_unused(vertices, without_pillows(faces)))
    require_sound(vertices, faces, closed=True, where=where)
    return vertices, faces
