"""Move the vertices of a finished asset under the light that was found; its maps and environment stay as they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from exmesh_graph.stage1.appearance.colours import UVTexture
from exmesh_graph.stage1.init import initial_state
from exmesh_graph.stage1.refine import Checkpoint, Progress, Resumed, refine
from exmesh_graph.stage1.regularise import Smoothness
from exmesh_graph.stage1.render import draw, surface_of
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage3.lit import Lit
from exmesh_graph.stage3.settings import ReshapeSettings
from exmesh_graph.targets import Targets, prepare_targets
from exmesh_graph.types import Asset, Mesh, Stage1State, Transport, Views

_VIEWS = 24
"""Views that tell what the light explains, at most."""
_INNER = 0.99
"""Coverage of a pixel that has nothing of the background in it."""
_NOISE_DB = 0.1
"""What `explained` may be below 0 by chance."""


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
    Faces, atlas, maps and environment are the asset's, the texture is fitted along. An asset whose light explains
    nothing (`explained` is below 0 by more than noise) stays as it is: it would not know where to. Same inputs and seed
    give the same bytes on a CPU, also after a resume. Raises GeometryError for a transport of another mesh and what
    `refine` raises.
    """
    if settings.iterations == 0:
        return asset, {}
    lit = Lit(asset, transport, settings.lobe_samples, seed, str(device))
    start = initial_state(asset, views, texture="carrier", device=device)
    gain = explained(lit, start, prepare_targets(views, region=region, device=device, memory_gib=settings.memory_gib))
    if gain < -_NOISE_DB:
        return asset, {"explained": gain}
    steps = RefineSettings(
        iterations=settings.iterations, total_iterations=settings.iterations, fill_unseen=False,
        vertex_lr=settings.vertex_lr, vertex_decay=settings.vertex_decay, vertex_hold=0,
        texture_lr=settings.texture_lr, texture_decay=settings.texture_decay,
        ssim_weight=settings.ssim_weight, silhouette_weight=settings.silhouette_weight,
        gains=settings.gains, evidence=settings.evidence, memory_gib=settings.memory_gib,
    )  # fmt: skip
    state, history = refine(
        start, views, steps, smoothness=smoothness, region=region, appearance=lit, seed=seed, where=where,
        device=device, progress=progress, checkpoint=checkpoint, resumed=resumed,
    )  # fmt: skip
    moved = np.linalg.norm(state.vertices - asset.vertices, axis=1)
    history["explained"] = gain
    history["moved"] = {"mean": float(moved.mean()), "largest": float(moved.max())}
    return replace(asset, vertices=state.vertices, texture=state.texture), history


@torch.no_grad()
def explained(lit: Lit, start: Stage1State, targets: Targets) -> float:
    """By how many dB `lit`'s tints bring down the mean squared error of what `start` shows of the photographs, at its
    own shape and texture, over pixels inside the outline of some of the views; prepares `lit`."""
    surface = surface_of(start, lit.values.device)._replace(appearance=lit)
    lit.prepare(surface, targets)
    plain = surface._replace(appearance=UVTexture(lit.values))
    squares, size = np.zeros(2), (targets.height, targets.width)
    for view in range(0, len(targets), -(-len(targets) // _VIEWS)):
        camera = targets.intrinsics[view], targets.world_to_camera[view]
        for k, shown in enumerate((plain, surface)):
            picture = draw(shown, *camera, *size)
            inner = picture.alpha > _INNER
            if bool(targets.masked[view]):
                inner &= targets.alpha[view] > _INNER
            elif targets.inside is not None:
                inner &= targets.inside[view].to(inner.device)
            squares[k] += float((picture.colour - targets.images[view]).square()[inner].sum())
    return float(10 * np.log10(max(squares[0], 1e-12) / max(squares[1], 1e-12)))
