"""From the fitted parameters to an asset: whole maps, the texels that pixels speak for, the environment."""

from __future__ import annotations

import numpy as np
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.stage2.fill import complete_maps
from exmesh_graph.stage2.model import Model
from exmesh_graph.stage2.normal_map import normals_of
from exmesh_graph.stage2.stream import Evidence
from exmesh_graph.types import Asset, Carrier

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
def finished_asset(carrier: Carrier, model: Model) -> Asset:
    """The asset of the model's current parameters; texels that no view tells of are filled (stage2.fill)."""
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
    )
