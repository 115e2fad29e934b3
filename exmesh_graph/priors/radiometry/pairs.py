"""The same places in two photographs: how bright each shows them, and how far from its middle.

Stereo says where a place of one view lies in others. A camera's settings and lens change how bright a place is from
picture to picture; of all that does so they alone depend on where in a picture it is shown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from exmesh_graph.gpu.cores import share
from exmesh_graph.types import DepthMaps, Views

CELL, WINDOW = 12, 9
"""Pixels from place to place, and on a side of the window whose mean is taken."""
_SAME = 0.015  # of a depth
_ROUGH = 0.3  # deviation within the window, over its mean: an edge, where a pixel's error counts
_DARK, _BRIGHT = 0.004, 0.9  # of linear light: noise, and cut off


@dataclass(frozen=True)
class Pairs:
    """P places, each in two views.

    first, second          int [P], the views
    light, other           float64 [P], linear light (mean of the colours) that each shows
    squared, other_squared float64 [P], of the tangent of the angle to the camera's axis, in each
    facing, other_facing   float64 [P], cosine between the surface's normal and the way to each camera, at least 0.1
    """

    first: np.ndarray
    second: np.ndarray
    light: np.ndarray
    other: np.ndarray
    squared: np.ndarray
    other_squared: np.ndarray
    facing: np.ndarray
    other_facing: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    def of(self, chosen: np.ndarray) -> Pairs:
        """Those that are `chosen`, bool or indices."""
        return Pairs(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def pairs_of(views: Views, depths: DepthMaps, normals: np.ndarray, sources: np.ndarray) -> Pairs:
    """Places of each of `views` that one of its `sources` int [N, S] (-1: none) shows too, by their `depths`.

    normals  float32 [N, h, w, 3], in the cameras' axes, of the same views at another size, 0 where unknown
    Only smooth places count that neither picture shows black or cut off, and whose depths agree.
    """
    means, smooth = zip(*share(lambda k: _windows(np.asarray(views.images[k])), range(len(views))), strict=True)
    world_to_camera = views.world_to_camera
    found = share(
        lambda k: _of_view(k, views, world_to_camera, depths.depth, normals[k], means, smooth, sources[k]),
        range(len(views)),
    )
    first, second, *light = np.concatenate(found).T
    return Pairs(first.astype(int), second.astype(int), *light)


def _windows(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(mean light [H, W] of the window around each pixel, whether it tells something bool [H, W])."""
    light = picture.mean(axis=2, dtype=np.float64)
    mean, square = uniform_filter(light, WINDOW), uniform_filter(light**2, WINDOW)
    deviation = np.sqrt(np.maximum(square - mean**2, 0))
    told = (mean > _DARK) & (mean + deviation < _BRIGHT) & (deviation < _ROUGH * mean)
    told[:WINDOW] = told[-WINDOW:] = False
    told[:, :WINDOW] = told[:, -WINDOW:] = False
    return mean, told


def _of_view(
    view: int, views: Views, world_to_camera: np.ndarray, depths: np.ndarray, normals: np.ndarray,
    means: tuple[np.ndarray, ...], told: tuple[np.ndarray, ...], sources: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """float64 [P, 8], the fields of Pairs as columns, of places of one view."""
    down, across = np.meshgrid(
        np.arange(CELL // 2, views.height, CELL), np.arange(CELL // 2, views.width, CELL), indexing="ij"
    )
    facing = normals[down * len(normals) // views.height, across * normals.shape[1] // views.width]
    held = (depths[view][down, across] > 0) & told[view][down, across] & np.abs(facing).any(axis=-1)
    rows, columns, facing = down[held], across[held], facing[held]
    matrix, pose = views.intrinsics[view], views.camera_to_world[view]
    rays = np.stack(
        [(columns + 0.5 - matrix[0, 2]) / matrix[0, 0], (rows + 0.5 - matrix[1, 2]) / matrix[1, 1], np.ones(len(rows))],
        axis=1,
    )
    world = rays * depths[view][rows, columns][:, None] @ pose[:3, :3].T + pose[:3, 3]
    turned = facing @ pose[:3, :3].T
    found = [np.zeros((0, 8))]
    for source in sources[sources >= 0]:
        local = world @ world_to_camera[source, :3, :3].T + world_to_camera[source, :3, 3]
        z = np.maximum(local[:, 2], 1e-9)
        tangent = local[:, :2] / z[:, None]
        x, y = (views.intrinsics[source, k, k] * tangent[:, k] + views.intrinsics[source, k, 2] - 0.5 for k in (0, 1))
        inside = (local[:, 2] > 0) & (x > 0) & (y > 0) & (x < views.width - 1) & (y < views.height - 1)
        column = np.clip(np.round(x), 0, views.width - 1).astype(int)
        row = np.clip(np.round(y), 0, views.height - 1).astype(int)
        same = inside & told[source][row, column] & (np.abs(depths[source][row, column] / z - 1) < _SAME)
        other = map_coordinates(means[source], [y[same], x[same]], order=1, mode="nearest")
        found.append(np.stack([
            np.full(len(other), view), np.full(len(other), source), means[view][rows[same], columns[same]], other,
            (rays[same, :2] ** 2).sum(axis=1), (tangent[same] ** 2).sum(axis=1),
            *(_cosine(turned[same], world[same] - views.camera_to_world[k, :3, 3]) for k in (view, source)),
        ], axis=1))  # fmt: skip
    return np.concatenate(found)


def _cosine(normals: np.ndarray, along: np.ndarray) -> np.ndarray:
    """float64 [P], between normals [P, 3], unit, and the ways back `along` [P, 3] from the camera; at least 0.1."""
    return np.clip(-(normals * along).sum(axis=1) / np.linalg.norm(along, axis=1), 0.1, 1.0)


def tangents_squared(intrinsics: np.ndarray, height: int, width: int) -> np.ndarray:
    """float64 [H, W], square of the tangent of the angle between each pixel's ray and the camera's axis."""
    across = (np.arange(width) + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
    down = (np.arange(height) + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
    return np.asarray(across[None] ** 2 + down[:, None] ** 2)
