"""A world whose unit sphere is larger: stereo and fusion look inside it, and without masks it is a guess."""

from __future__ import annotations

from dataclasses import replace

from exmesh_graph.types import DepthMaps, PointCloud, Views


def widened(views: Views, reach: float) -> Views:
    """The views in a world whose unit sphere is `reach` times as large: positions divided by it, pixels as they are."""
    poses = views.camera_to_world.copy()
    poses[:, :3, 3] /= reach
    return replace(views, camera_to_world=poses)


def widened_points(points: PointCloud | None, reach: float) -> PointCloud | None:
    """The points in that world."""
    return None if points is None else replace(points, points=(points.points / reach).astype(points.points.dtype))


def brought_back(depths: DepthMaps, reach: float) -> DepthMaps:
    """Depth maps of that world in the views' own."""
    return replace(depths, depth=(depths.depth * reach).astype(depths.depth.dtype))
