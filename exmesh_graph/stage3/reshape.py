"""Move the vertices of a finished asset under the light that was found; its maps and environment stay as they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.refine import Checkpoint, Progress, Resumed, refine
from exmesh_graph.stage1.regularise import Smoothness
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage3.lit import Lit
from exmesh_graph.stage3.settings import ReshapeSettings
from exmesh_graph.types import Asset, Mesh, Transport, Views


def reshape(
    asset: Asset,
    views: Views,
    transport: Transport,
    settings: ReshapeSettings,
    *,
    smoothness: Smoothness | None = None,
    region: Mesh | None = None,
    seed: int = 0,
    where: str = "stage3.refine",
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Resumed | None = None,
) -> tuple[Asset, dict[str, Any]]:
    """The asset with vertices that fit `views` better under its own light, and the fit's history as `refine` gives it.

    transport  of the asset's own mesh; shadows and light between surfaces stay those of it
    smoothness, region  as for `stage1.refine.refine`
    Faces, atlas, maps and environment are the asset's, the texture is fitted along. Same inputs and seed give the same
    bytes on a CPU, also after a resume. Raises GeometryError for a transport of another mesh and what `refine` raises.
    """
    if settings.iterations == 0:
        return asset, {}
    lit = Lit(asset, transport, settings.lobe_samples, seed, str(device))
    steps = RefineSettings(
        iterations=settings.iterations, total_iterations=settings.iterations, fill_unseen=False,
        vertex_lr=settings.vertex_lr, vertex_decay=settings.vertex_decay,
        texture_lr=settings.texture_lr, texture_decay=settings.texture_decay,
        ssim_weight=settings.ssim_weight, silhouette_weight=settings.silhouette_weight,
        gains=settings.gains, evidence=settings.evidence, memory_gib=settings.memory_gib,
    )  # fmt: skip
    start = initial_state(asset, views, texture="carrier", device=device)
    state, history = refine(
        start, views, steps, smoothness=smoothness, region=region, appearance=lit, seed=seed, where=where,
        device=device, progress=progress, checkpoint=checkpoint, resumed=resumed,
    )  # fmt: skip
    moved = np.linalg.norm(state.vertices - asset.vertices, axis=1)
    history["moved"] = {"mean": float(moved.mean()), "largest": float(moved.max())}
    return replace(asset, vertices=state.vertices, texture=state.texture), history
