"""Pictures of one round of Stage I: the shape from all sides, its edges, its atlas in colours of stretch."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.gallery.atlas import atlas_panels
from exmesh_graph.gallery.pictures import GalleryWriter, shrink, stack, strip
from exmesh_graph.gallery.shaded import shaded_geometry
from exmesh_graph.types import Carrier, Gallery

DIRECTIONS = 6
_WIDTH = 1050  # of a whole picture, pixels
_GAP = 6
_ZOOM = 4.0


def round_gallery(root: Path, carrier: Carrier) -> Gallery:
    """Two pictures: clay from six sides over wires from two and a close-up; the atlas with its stretch."""
    writer = GalleryWriter(root)
    size = f"{len(carrier.faces)} faces, {len(carrier.vertices)} vertices"
    writer.add(
        "shape",
        "Shape",
        f"{size}. Above: from {DIRECTIONS} sides. Below: edges from two sides, and {_ZOOM:g} times closer "
        "where faces are smallest.",
        [stack([strip(_turntable(carrier)), strip(_wires(carrier))])],
    )
    panels, figures = atlas_panels(carrier, _panel(3))
    writer.add("atlas", "Atlas", figures, panels)
    return writer.finish()


def _panel(columns: int) -> int:
    return (_WIDTH - (columns - 1) * _GAP) // columns


def _turntable(carrier: Carrier) -> list[np.ndarray]:
    side = _panel(DIRECTIONS)
    shots = zip(*orbit(DIRECTIONS, side, side, radius=_reach(carrier)), strict=True)
    return [shrink(shaded_geometry(carrier, k, pose, side, side, 2.0)[0], side) for k, pose in shots]


def _wires(carrier: Carrier) -> list[np.ndarray]:
    side = _panel(3)
    intrinsics, poses = orbit(2, side, side, start=0.5, radius=_reach(carrier))
    close = intrinsics[0].copy()
    x, y = _densest(carrier, intrinsics[0], poses[0])
    close[:2] *= _ZOOM
    close[:2, 2] = side / 2 + _ZOOM * (intrinsics[0][:2, 2] - (x, y))
    shots = [(intrinsics[0], poses[0]), (intrinsics[1], poses[1]), (close, poses[0])]
    return [shrink(shaded_geometry(carrier, k, pose, side, side, 2.0)[2], side) for k, pose in shots]


def _densest(carrier: Carrier, intrinsics: np.ndarray, pose: np.ndarray) -> tuple[float, float]:
    """The pixel in the middle of the smallest tenth of the faces that look at the camera."""
    corner = carrier.vertices[carrier.faces].astype(np.float64)
    middle, normal = corner.mean(axis=1), np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(normal, axis=1)
    facing = np.einsum("fi,fi->f", normal, pose[:3, 3] - middle) > 0.5 * size
    chosen = np.flatnonzero(facing & (size <= np.quantile(size[facing], 0.1))) if facing.any() else np.arange(len(size))
    seen = (middle[chosen] - pose[:3, 3]) @ pose[:3, :3] @ intrinsics.T
    x, y = np.median(seen[:, :2] / seen[:, 2:], axis=0)
    nearest = np.argmin(((seen[:, :2] / seen[:, 2:] - (x, y)) ** 2).sum(axis=1))  # a face, not a hole between faces
    at = seen[nearest]
    return float(at[0] / at[2]), float(at[1] / at[2])


def _reach(carrier: Carrier) -> float:
    """Radius of the ball around the origin that holds the mesh."""
    return float(np.sqrt((carrier.vertices.astype(np.float64) ** 2).sum(axis=1).max(initial=1e-12)))
