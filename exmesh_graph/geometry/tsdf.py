"""Depth maps to a surface: truncated signed distance fusion (Curless and Levoy 1996) with Open3D's voxel grid."""

from __future__ import annotations

import contextlib

import numpy as np

from exmesh_graph.errors import GeometryError
from exmesh_graph.geometry.clean import weld
from exmesh_graph.geometry.settings import TsdfSettings
from exmesh_graph.native import import_open3d
from exmesh_graph.types import DepthMaps, Views

_BLOCK = 16
_DEPTH_MAX = 10.0  # normalised units


def fuse(
    views: Views,
    depths: DepthMaps,
    settings: TsdfSettings | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mesh (vertices float32 [V, 3], faces int32 [F, 3]) in the views' world; open where nothing was seen.

    Depth stays float32 from end to end. Faces are counter-clockwise from the side the cameras are on.
    Raises DataError where views and depth maps do not belong together, GeometryError where no surface results.
    """
    settings = settings or TsdfSettings()
    voxel, truncation = 2.0 / (settings.resolution or 128), settings.truncation
    depths.require_of(views, "init.tsdf")
    o3d = import_open3d()
    device = o3d.core.Device("CPU:0")
    blocks = int((2.4 / (voxel * _BLOCK)) ** 2 * 12) + 1000
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight"), attr_dtypes=(o3d.core.float32, o3d.core.float32), attr_channels=((1), (1)),
        voxel_size=voxel, block_resolution=_BLOCK, block_count=blocks, device=device,
    )  # fmt: skip
    for view in range(len(views)):
        depth = depths.depth[view]
        if settings.masked:
            depth = np.where(views.alpha[view] >= 0.5, depth, 0)
        if settings.radius > 0:
            distance = _distances(depth, views.intrinsics[view], views.camera_to_world[view])
            depth = np.where(distance < settings.radius, depth, 0)
        if not (depth > 0).any():
            continue
        image = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(depth[..., None], np.float32)))
        # Open3D's fusion cuts projected coordinates down to whole pixels, so a pixel covers [i, i + 1] as ours does
        # (measured: shifting the principal point by half a pixel makes the error 2.7 times larger).
        intrinsic = o3d.core.Tensor(np.ascontiguousarray(views.intrinsics[view], np.float64))
        extrinsic = o3d.core.Tensor(np.ascontiguousarray(views.world_to_camera[view], np.float64))
        seen = (image, intrinsic, extrinsic)
        options = {"depth_scale": 1.0, "depth_max": _DEPTH_MAX, "trunc_voxel_multiplier": float(truncation)}
        grid.integrate(grid.compute_unique_block_coordinates(*seen, **options), *seen, **options)
    # Extraction from a grid without a single block, or of no face at all, is an internal error of Open3D.
    mesh = None
    if grid.hashmap().size():
        with contextlib.suppress(RuntimeError):
            mesh = grid.extract_triangle_mesh(weight_threshold=settings.min_weight - 0.5)
    if mesh is None or "indices" not in mesh.triangle or len(mesh.triangle.indices) == 0:
        raise GeometryError(
            "fusing the depth maps gave no surface", where="init.tsdf",
            expected="depth > 0 inside the unit sphere, in normalised units",
            fix="check units and scale of the depth maps, and `masked`",
        )  # fmt: skip
    vertices, faces = mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy()
    return canonical_order(vertices.astype(np.float32), faces.astype(np.int32))


def _distances(depth: np.ndarray, intrinsics: np.ndarray, camera_to_world: np.ndarray) -> np.ndarray:
    """Distance [H, W] from the origin of every pixel's point."""
    rows, columns = np.indices(depth.shape) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(intrinsics).T
    points = (depth[..., None] * rays) @ camera_to_world[:3, :3].T + camera_to_world[:3, 3]
    return np.linalg.norm(points, axis=-1)


def canonical_order(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same mesh in an order that does not depend on hash tables or threads: vertices and faces sorted."""
    vertices, faces = weld(vertices, faces)
    first = faces.argmin(1)
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    return vertices, np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])])
