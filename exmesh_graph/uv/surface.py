"""Where on the surface the texels of an atlas lie."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.types import Carrier
from exmesh_graph.uv.raster import rasterize_atlas


class TexelSurface(NamedTuple):
    """What each texel shows: position float32 [R, R, 3] and unit face normal [R, R, 3], normalised world.

    Texels off the charts stand for the nearest one on a chart: bilinear lookups and mip levels read them too.
    """

    position: np.ndarray
    normal: np.ndarray


def texel_surface(carrier: Carrier, size: int) -> TexelSurface:
    """The surface under every texel of size x size maps. Raises DataError for an atlas without a texel in a chart."""
    from scipy.ndimage import distance_transform_edt

    face, bary = rasterize_atlas(carrier.uvs, carrier.uv_faces, size)
    if not (face >= 0).any():
        raise DataError("no texel lies in a chart", expected="an atlas in [0, 1]^2", fix="unwrap it again")
    row, column = distance_transform_edt(face < 0, return_distances=False, return_indices=True)
    face, bary = face[row, column], bary[row, column]
    corners = carrier.vertices[carrier.faces[face]]
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    position = np.einsum("hwc,hwcx->hwx", bary, corners)
    return TexelSurface(position.astype(np.float32), normal.astype(np.float32))
