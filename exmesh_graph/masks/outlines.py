"""Masks of a surface: drawn into the views, their outlines moved to the edges of the pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy.ndimage import distance_transform_edt, zoom

from exmesh_graph.gpu.cores import share
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.train_size import reduced
from exmesh_graph.masks.cut import moved_to_edges
from exmesh_graph.masks.drawn import drawn_outlines
from exmesh_graph.masks.ground import Table, table_shown
from exmesh_graph.masks.pinhole import thinned
from exmesh_graph.masks.settings import CutSettings
from exmesh_graph.types import Views

_SMALL = 256


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
    small, shown, factor = looked_at(views, settings)
    outlines = drawn_outlines(vertices, faces, small)
    # an object of few pixels has fine parts: there the band is a part of the picture
    band = settings.band * float(np.clip(max(small.height, small.width) / _SMALL, 0.5, 1))
    likely = table_chance(table, small, shown, factor, outlines, vertices)
    full = views.height, views.width

    def one(view: int) -> np.ndarray:
        by_table = None if likely is None else likely[view]
        found = moved_to_edges(shown[view], outlines[view], band, settings.smoothness, by_table)
        if factor > 1:
            large = _enlarged(found, factor, full)
            found = moved_to_edges(_display(views.images[view]), large, 1.5 * factor, settings.smoothness)
        return found

    return np.stack(share(one, _counted(len(views), progress)))


def _counted(views: int, progress: Callable[[int, int], None] | None) -> Iterator[int]:
    for view in range(views):
        if progress is not None:
            progress(view + 1, views)
        yield view


def looked_at(views: Views, settings: CutSettings) -> tuple[Views, np.ndarray, int]:
    """(the views at about `settings.side` pixels, their display colours [N, h, w, 3], the factor between)."""
    factor = max(1, math.ceil(max(views.width, views.height) / settings.side))
    small = reduced(views, factor)
    return small, np.stack([_display(picture) for picture in small.images]), factor


def table_chance(
    table: Table | None, small: Views, shown: np.ndarray, factor: int, outlines: np.ndarray, vertices: np.ndarray
) -> np.ndarray | None:
    """`ground.table_shown` of reduced views; None without a table."""
    if table is None:
        return None
    depth = thinned(table.depths.depth, (small.height, small.width), factor)
    return table_shown(table.plane, small, shown, depth, outlines, vertices)


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
