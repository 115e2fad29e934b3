"""Patches of one view that tell where others stand: places with paint, evenly spread, of which stereo has the depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from exmesh_graph.io.lens import LensChange

#: Pixels on a side of the cells of which each gives a patch, and patches of a view at most.
CELL, MOST = 12, 900
_PAINT = 0.01  # change of even gray from pixel to pixel
_RIM = 8


@dataclass(frozen=True)
class Patches:
    """P patches of a view.

    rays     float64 [P, 3], X / Z of the camera's pixels, Z = 1
    depths   float64 [P], along the camera's axis
    normals  float64 [P, 3], unit, in the camera's axes
    """

    rays: np.ndarray
    depths: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.depths)

    def as_shown(self, change: LensChange) -> Patches:
        """The same pixels before lenses were taken for others: depths stay those of the pixels."""
        shown = change.shown(self.rays[:, :2])
        scale = np.linalg.norm(self.rays[:, :2], axis=1) / np.maximum(np.linalg.norm(shown, axis=1), 1e-12)
        normals = self.normals * np.stack([scale, scale, np.ones(len(scale))], axis=1)
        rays = np.concatenate([shown, self.rays[:, 2:]], axis=1)
        return replace(self, rays=rays, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))


def patches_of(gray: np.ndarray, intrinsics: np.ndarray, depth: np.ndarray, normals: np.ndarray) -> Patches:
    """Of each cell of `gray` [h, w] the pixel that changes most; of these the 900 that change most.

    depth    [H, W], 0 unknown, and normals [g, f, 3]: of the same view at other sizes
    """
    height, width = gray.shape
    rows, columns = np.arange(height), np.arange(width)
    known = depth[np.ix_(_nearest(rows, height, len(depth)), _nearest(columns, width, depth.shape[1]))]
    facing = normals[np.ix_(_nearest(rows, height, len(normals)), _nearest(columns, width, normals.shape[1]))]
    slope = np.hypot(*np.gradient(gaussian_filter(gray, 1.0)))
    slope[(known <= 0) | (np.abs(facing).sum(axis=2) == 0)] = 0
    slope[:_RIM] = slope[-_RIM:] = 0
    slope[:, :_RIM] = slope[:, -_RIM:] = 0
    tall, wide = height // CELL, width // CELL
    cells = slope[: tall * CELL, : wide * CELL].reshape(tall, CELL, wide, CELL).transpose(0, 2, 1, 3)
    cells = cells.reshape(tall, wide, CELL * CELL)
    best, most = cells.argmax(axis=2), cells.max(axis=2)
    held = most > _PAINT
    y = (np.arange(tall)[:, None] * CELL + best // CELL)[held]
    x = (np.arange(wide)[None] * CELL + best % CELL)[held]
    order = np.argsort(-most[held], kind="stable")[:MOST]
    x, y = x[order], y[order]
    rays = np.stack(
        [(x + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0], (y + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1],
         np.ones(len(x))], axis=1,
    )  # fmt: skip
    return Patches(rays, known[y, x].astype(np.float64), facing[y, x].astype(np.float64))


def _nearest(rows: np.ndarray, size: int, other: int) -> np.ndarray:
    """The rows (or columns) of a picture of `other` ones at the middles of `rows` of one of `size`."""
    return np.minimum(((rows + 0.5) * other / size).astype(int), other - 1)
