"""The surface point behind a pixel."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.types import Mesh, Views


def picked_point(mesh: Mesh, views: Views, view: str, pixel: tuple[float, float]) -> np.ndarray:
    """float64 [3], normalised world: where the ray through `pixel` (x right, y down; centres at +0.5) of `view` meets
    the mesh. Raises DataError for a view that does not exist, a pixel outside it and a ray that misses.
    """
    from exmesh_graph.rays import make_ray_tracer

    if view not in views.names:
        some = ", ".join(views.names[:8]) + (", ..." if len(views.names) > 8 else "")
        raise DataError(f"there is no view {view!r}", expected=f"one of {some}", fix="correct `view`")
    if not (0 <= pixel[0] <= views.width and 0 <= pixel[1] <= views.height):
        raise DataError(
            f"pixel ({pixel[0]:g}, {pixel[1]:g}) lies outside view {view}",
            expected=f"0 to {views.width}, 0 to {views.height}",
            fix="correct `pixel`: x to the right, y down, from the upper left corner",
        )
    number = views.names.index(view)
    pose = views.camera_to_world[number]
    in_camera = np.linalg.solve(views.intrinsics[number], np.array([*pixel, 1.0]))
    direction = pose[:3, :3] @ in_camera
    direction /= np.linalg.norm(direction)
    origin = pose[:3, 3]
    hits = make_ray_tracer(mesh.vertices, mesh.faces).closest_hit(origin[None], direction[None])
    distance = float(hits.t[0])
    if not np.isfinite(distance):
        raise DataError(
            f"pixel ({pixel[0]:g}, {pixel[1]:g}) of view {view} does not show the mesh",
            expected=f"a pixel on the object, in {views.width} x {views.height}",
            fix="correct `pixel`: x to the right, y down, from the upper left corner",
        )
    return origin + distance * direction
