"""Views at a whole fraction of their size: what fits see where the pictures are larger than their time allows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from exmesh_graph.io.cameras import scale_intrinsics
from exmesh_graph.io.picture_files import with_pictures
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.types import Views


def factor_for(views: Views, side: int, megapixels: float) -> int:
    """The least whole factor that brings the longer side of `views` to `side` pixels and all of them together to
    `megapixels`, at most; 0 sets no limit."""
    factor = max(1, math.ceil(max(views.width, views.height) / side)) if side else 1
    while megapixels and factor < min(views.width, views.height):
        if len(views) * (views.width // factor) * (views.height // factor) <= 1e6 * megapixels:
            break
        factor += 1
    return factor


def reduced(views: Views, factor: int) -> Views:
    """Views at 1 / `factor` of their size, by exact area means in linear light.

    Sizes that `factor` does not divide lose their last rows or columns. A large set goes into files, as at loading.
    """
    height, width = views.height // factor, views.width // factor
    if factor == 1:
        return views

    def small(part: np.ndarray) -> np.ndarray:
        return downscale_area(np.asarray(part)[: height * factor, : width * factor], factor)

    pictures = ((small(views.images[i]), small(views.alpha[i]), None) for i in range(len(views)))
    fewer = with_pictures(views, pictures, height, width)
    return replace(fewer, intrinsics=scale_intrinsics(views.intrinsics, factor))
