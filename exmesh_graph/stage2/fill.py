"""Texels that no training view saw: filled smoothly over the surface, then spread past the charts' borders."""

from __future__ import annotations

import numpy as np

from exmesh_graph.types import Carrier
from exmesh_graph.uv.raster import rasterize_atlas

NEIGHBOURS = 12


def complete_maps(maps: np.ndarray, seen: np.ndarray, carrier: Carrier) -> np.ndarray:
    """`maps` [R, R, C] with every texel outside `seen` bool [R, R] filled, float32.

    On a chart: the mean of the nearest seen texels *in space* (not in the atlas, where charts that touch need not be
    neighbours), weighted by inverse distance. Off the charts: the nearest filled texel of the atlas.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.spatial import cKDTree

    size = maps.shape[0]
    filled = maps.astype(np.float32).copy()
    face, bary = rasterize_atlas(carrier.uvs, carrier.uv_faces, size)
    covered = face >= 0
    corners = carrier.vertices[carrier.faces[face.clip(0)]]
    position = np.einsum("hwc,hwcx->hwx", bary, corners)
    known, wanted = seen & covered, covered & ~seen
    if known.any() and wanted.any():
        tree = cKDTree(position[known])
        count = min(NEIGHBOURS, int(known.sum()))
        distance, index = tree.query(position[wanted], k=count)
        distance, index = distance.reshape(-1, count), index.reshape(-1, count)
        weight = 1 / np.maximum(distance, 1e-6)
        weight /= weight.sum(axis=1, keepdims=True)
        filled[wanted] = np.einsum("nk,nkc->nc", weight, filled[known][index])
    done = covered | seen if known.any() else seen
    if done.any() and not done.all():
        row, column = distance_transform_edt(~done, return_distances=False, return_indices=True)
        filled = filled[row, column]
    return filled
