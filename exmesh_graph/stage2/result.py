"""From the fitted parameters to an asset: whole maps, the texels that pixels speak for, the environment.

Texels that no training view saw are filled smoothly over the surface, then spread past the charts' borders.
"""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.gbuffer import Evidence
from exmesh_graph.stage2.surface import normals_of
from exmesh_graph.types import Asset, Carrier
from exmesh_graph.uv.raster import rasterize_atlas

#: Bilinear weight over all pixels of all views from which a texel counts as seen: one pixel's worth, or this share of
#: the median texel's where maps are finer than pixels. Adam moves a texel that the corner of one footprint touches as
#: fast as any other: such texels, most of them on the borders of charts, end up anywhere.
SEEN_WEIGHT, SEEN_SHARE = 1.0, 0.1


def texel_confidence(evidence: Evidence) -> torch.Tensor:
    """[T] in [0, 1): w / (1 + w) x v / (1 + v) x mean cosine, for w pixels' worth of weight from v views.

    One half for each of one pixel and one view; seen at a grazing angle counts less.
    """
    weight, views = evidence.weight, evidence.views
    return weight / (1 + weight) * views / (1 + views) * evidence.cosine


@torch.no_grad()
def finished_asset(carrier: Carrier, model: Decomposition) -> Asset:
    """The asset of the model's current parameters; texels that no view tells of are filled."""
    texels, size = model.maps.texels, model.maps.size
    evidence = model.buffers.evidence.weight
    seen_rows = evidence >= min(SEEN_WEIGHT, SEEN_SHARE * float(evidence[evidence > 0].median()))
    count = size * size
    maps = model.maps.values()
    values = torch.zeros(count, maps.shape[1], device=maps.device)
    values[texels] = maps
    seen = torch.zeros(count, dtype=torch.bool, device=maps.device)
    seen[texels[seen_rows]] = True
    image = values.reshape(size, size, -1).cpu().numpy()
    seen_image = seen.reshape(size, size).cpu().numpy()
    confidence = torch.zeros(count, device=maps.device)
    confidence[texels[seen_rows]] = texel_confidence(model.buffers.evidence)[seen_rows]
    confidence_image = confidence.reshape(size, size).cpu().numpy()
    image = complete_maps(image, seen_image, carrier, confidence_image)
    return Asset(
        vertices=carrier.vertices,
        faces=carrier.faces,
        uvs=carrier.uvs,
        uv_faces=carrier.uv_faces,
        texture=carrier.texture,
        base_color=np.ascontiguousarray(image[..., :3]),
        roughness=np.ascontiguousarray(image[..., 3]),
        metallic=np.ascontiguousarray(image[..., 4]) if model.settings.metallic else None,
        normal=normals_of(image[..., -2:]) if model.settings.normal_map else None,
        seen=seen_image,
        confidence=confidence_image,
        environment=envmap.radiance_of(model.environment).cpu().numpy(),
        light_axis=model.light_axis,
    )


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
            nearby = tree.query(places[start : start + CHUNK], k=count)
            distance, index = (column.reshape(-1, count) for column in nearby)
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
