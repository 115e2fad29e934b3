"""Scoring a Stage I carrier on held-out views, and what a stage has reached."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exmesh_graph.evaluate.mesh import score_mesh
from exmesh_graph.evaluate.scores import Pictures, compare, held_out_pairs, pairs_for_pictures
from exmesh_graph.io.images import display
from exmesh_graph.io.shots import spread
from exmesh_graph.types import Carrier, Mesh, SceneTruth, ScoredViews, Stage1State, Views


@dataclass
class CarrierScores:
    """Figures of a carrier, and the (ours, truth) display images of the scored views."""

    values: dict[str, Any]
    views: list[int]
    held_out: Pictures


def score_carrier(carrier: Carrier, views: Views, *, max_views: int = 0, region: Mesh | None = None) -> CarrierScores:
    """Held-out PSNR and SSIM of the mesh with its appearance model (no light model: what Stage I itself has learnt).

    Views without masks are compared where the carrier shows, or where `region` does, so that carriers of different
    outlines are scored on the same pixels.
    Where the model is not the texture, `psnr_baked` is the PSNR with the texture that was baked from it, which is what
    Stage II and exports see.
    """
    from exmesh_graph.stage1.render import render_carrier
    from exmesh_graph.targets import shown_pixels

    chosen = spread(len(views), max_views)
    shown, alpha = render_carrier(carrier, views.subset(chosen))
    true = [display(views.images[i], views.alpha[i]) for i in chosen]
    if not views.has_masks:
        inside = alpha if region is None else shown_pixels(region, views.subset(chosen)).numpy()
        true = [image * part[..., None] for image, part in zip(true, inside, strict=True)]
        if region is not None:
            shown = shown * inside[..., None]
    pairs = list(zip(shown, true, strict=True))
    db, structure = compare([ours for ours, _ in pairs], [true for _, true in pairs])
    names = [views.names[i] for i in chosen]
    mean = float(np.mean(db))
    values: dict[str, Any] = {
        "headline": [
            {
                "label": "Held-out PSNR, Stage I",
                "value": mean,
                "unit": "dB",
                "better": "higher",
                "series": "held-out PSNR",
                "over": {"vertices": len(carrier.vertices)},
            }
        ],
        "held_out": {
            "psnr": mean,
            "ssim": float(np.mean(structure)),
            "psnr_per_view": dict(zip(names, db, strict=True)),
            "ssim_per_view": dict(zip(names, structure, strict=True)),
            "region": "whole image, over black"
            if views.has_masks
            else ("inside our silhouette" if region is None else "where the wired region shows"),
            "views": len(names),
        },
    }
    if isinstance(carrier, Stage1State) and carrier.appearance != "uv_texture":
        baked, _ = render_carrier(replace(carrier, appearance="uv_texture", model={}), views.subset(chosen))
        db, _ = compare(list(baked), [image for _, image in pairs])
        values["held_out"]["psnr_baked"] = float(np.mean(db))
    return CarrierScores(values, chosen, pairs)


def carrier_pairs(scores: CarrierScores, views: Views, count: int) -> ScoredViews:
    """`count` of the scored views."""
    names = [views.names[i] for i in scores.views]
    return pairs_for_pictures(held_out_pairs(scores.values, scores.held_out, names, count), views, scores.views)


def score_stage(
    carrier: Carrier,
    views: Views | None,
    truth: SceneTruth | None,
    *,
    samples: int = 10_000,
    max_views: int = 8,
    seed: int = 0,
) -> dict[str, Any]:
    """`stages`: Chamfer (with a truth) and held-out PSNR (with views), as points of the report's charts only."""
    values: dict[str, Any] = {"faces": len(carrier.faces), "vertices": len(carrier.vertices)}
    stages: list[dict[str, Any]] = []
    if truth is not None:
        stages += score_mesh(carrier, truth, samples=samples, seed=seed)["headline"]
    if views is not None:
        stages += score_carrier(carrier, views, max_views=max_views).values["headline"]
    values["stages"] = [stage for stage in stages if stage.get("series")]
    return values
