"""Texels that no training view saw: filled smoothly over the surface, then spread past the charts' borders."""

from __future__ import annotations

import numpy as np

from exmesh_graph.types import Carrier
from exmesh_graph.uv.raster import rasterize_atlas

#: Enough to reach past the rim of what is seen, whose texels were only looked at from the side.
NEIGHBOURS = 48
CHUNK = 1 << 16


def complete_maps(
    maps: np.ndarray, seen: np.ndarray, carrier: Carrier, confidence: np.ndarray | None = None
) -> np.ndarray:
    """`maps` [R, R, C] with every texel outside `seen` bool [R, R] filled, float32.

    On a chart: the mean of the nearest seen texels *in space* (not in the atlas, where charts that touch need not be
    neighbours), weighted by inverse distance and squared `confidence` [R, R]. Off the charts: the nearest filled texel
    of the atlas.
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
        trust = np.ones(int(known.sum())) if confidence is None else np.maximum(confidence[known], 1e-3) ** 2
        source, places, means = filled[known], position[wanted], []
        for start in range(0, len(places), CHUNK):
            distance, index = (found.reshape(-1, count) for found in tree.query(places[start : start + CHUNK], k=count))
            nearest = np.maximum(distance[:, :1], 1e-12)
            weight = trust[index] / np.maximum(distance, nearest)
            weight /= weight.sum(axis=1, keepdims=True)
            means.append(np.einsum("nk,nkc->nc", weight, source[index]))
        filled[wanted] = np.concatenate(means)
    done = covered | seen if known.any() else seen
    if done.any() and not done.all():
        row, column = distance_transform_edt(~done, return_distances=False, return_indices=True)
        filled = filled[row, column]
    return filled
