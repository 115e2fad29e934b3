"""Views at a whole fraction of their size: what fits see where the pictures are larger than their time allows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from exmesh_graph.io.cameras import scale_intrinsics
from exmesh_graph.io.picture_files import Files
from exmesh_graph.io.reduce import downscale_area
from exmesh_graph.types import Views
from exmesh_graph.types.pictures import too_large


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
    files = Files.of(len(views), height, width) if too_large(len(views), height, width) else None
    pictures = []
    for number in range(len(views)):
        whole = (np.asarray(part[number])[: height * factor, : width * factor] for part in (views.images, views.alpha))
        rgb, alpha = (downscale_area(part, factor) for part in whole)
        if files is None:
            pictures.append((rgb, alpha))
        else:
            files.put(number, rgb, alpha, None)
    return replace(
        views,
        images=np.stack([rgb for rgb, _ in pictures]) if files is None else files.images.stack(),
        alpha=np.stack([alpha for _, alpha in pictures]) if files is None else files.alpha.stack(),
        intrinsics=scale_intrinsics(views.intrinsics, factor),
    )
