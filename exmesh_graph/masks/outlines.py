"""Masks of a surface: drawn into the views, their outlines moved to the edges of the pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt, zoom

from exmesh_graph.gpu.cores import share
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.train_size import reduced
from exmesh_graph.masks.cut import moved_to_edges
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.pinhole import thinned
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.masks.table import Table, table_shown
from exmesh_graph.types import Views

_SMALL = 256


@dataclass(frozen=True)
class Small:
    """What outlines are first moved in: views of about `CutSettings.side` pixels, their display colours `shown` float32
    [N, h, w, 3], the `factor` between, and the table with depth maps of that size."""

    views: Views
    shown: np.ndarray
    factor: int
    table: Table | None

    @classmethod
    def of(cls, views: Views, settings: CutSettings, table: Table | None = None) -> Small:
        """Of whole views, and of the table that the object in them stands on."""
        factor = max(1, math.ceil(max(views.width, views.height) / settings.side))
        small = reduced(views, factor)
        shown = np.stack([_display(picture) for picture in small.images])
        if table is not None:
            depth = thinned(table.depths.depth, (small.height, small.width), factor)
            table = Table(table.plane, replace(table.depths, depth=depth))
        return cls(small, shown, factor, table)

    def table_chance(self, outlines: np.ndarray, vertices: np.ndarray) -> np.ndarray | None:
        """`ground.table_shown`; None without a table."""
        if self.table is None:
            return None
        return table_shown(self.table.plane, self.views, self.shown, self.table.depths.depth, outlines, vertices)


def masks_of_surface(
    views: Views,
    vertices: np.ndarray,
    faces: np.ndarray,
    settings: CutSettings | None = None,
    *,
    table: Table | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """bool [N, H, W]: what shows the mesh (vertices [V, 3], faces [F, 3]), cut to the edges of the pictures.

    table  what the object stands on: where other views show it, its colours tell it from the object too

    In pictures of about `settings.side` pixels first; brought to full size the outline may move by the width of a
    reduced pixel once more. A view in which the mesh is not seen has no pixel.
    """
    settings = settings or CutSettings()
    small = Small.of(views, settings, table)
    masks = small_masks(small, vertices, faces, settings, progress)
    return refined(views, masks, small.factor, settings)


def small_masks(
    small: Small,
    vertices: np.ndarray,
    faces: np.ndarray,
    settings: CutSettings,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """bool [N, h, w]: the masks of `masks_of_surface` in the reduced views."""
    outlines = drawn_outlines(vertices, faces, small.views)
    # an object of few pixels has fine parts: there the band is a part of the picture
    band = settings.band * float(np.clip(max(small.views.height, small.views.width) / _SMALL, 0.5, 1))
    likely = small.table_chance(outlines, vertices)

    def one(view: int) -> np.ndarray:
        by_table = None if likely is None else likely[view]
        return moved_to_edges(small.shown[view], outlines[view], band, settings.smoothness, by_table)

    return np.stack(share(one, _counted(len(outlines), progress)))


def refined(views: Views, masks: np.ndarray, factor: int, settings: CutSettings) -> np.ndarray:
    """bool [N, H, W] of bool [N, h, w], `factor` times as large and moved once more to edges of the whole pictures."""
    if factor == 1:
        return masks
    full = views.height, views.width

    def one(view: int) -> np.ndarray:
        large = _enlarged(masks[view], factor, full)
        return moved_to_edges(_display(views.images[view]), large, 1.5 * factor, settings.smoothness)

    return np.stack(share(one, range(len(masks))))


def _counted(views: int, progress: Callable[[int, int], None] | None) -> Iterator[int]:
    for view in range(views):
        if progress is not None:
            progress(view + 1, views)
        yield view


def _display(picture: np.ndarray) -> np.ndarray:
    """float32 [H, W, 3], display colour of linear [H, W, 3]."""
    return linear_to_srgb(np.clip(np.asarray(picture), 0, 1)).astype(np.float32)


def _enlarged(inside: np.ndarray, factor: int, shape: tuple[int, ...]) -> np.ndarray:
    """bool of `shape`: the outline at `factor` times its size, straight between the reduced pixels' middles."""
    if inside.all() or not inside.any():
        return np.full(shape, bool(inside.any()))
    distance = distance_transform_edt(inside) - distance_transform_edt(~inside)
    large = zoom(distance, factor, order=1, mode="nearest", grid_mode=True) > 0
    return np.pad(large, [(0, full - part) for full, part in zip(shape, large.shape, strict=True)], mode="edge")
