"""Scoring a Stage I carrier on held-out views, and what a stage has reached."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exmesh_graph.evaluate.coverage import Compared, compare_views, region_rows, share_figures
from exmesh_graph.evaluate.mesh import score_mesh
from exmesh_graph.evaluate.scores import Pictures, exposure_words, held_out_pairs, pairs_for_pictures
from exmesh_graph.evaluate.settings import Exposure
from exmesh_graph.io.shots import spread
from exmesh_graph.types import Carrier, Region, SceneTruth, ScoredViews, Stage1State, Views


@dataclass
class CarrierScores:
    """Figures of a carrier, and what they were computed from."""

    values: dict[str, Any]
    compared: Compared

    @property
    def held_out(self) -> Pictures:
        """(ours, truth) display images of the scored views."""
        return self.compared.pairs


def score_carrier(
    carrier: Carrier,
    views: Views,
    *,
    max_views: int = 0,
    region: Region | None = None,
    exposure: Exposure = "fixed",
) -> CarrierScores:
    """Held-out PSNR and SSIM of the mesh with its appearance model (no light model: what Stage I itself has learnt).

    Compared is the whole picture over black, or, without masks, what counts by `region` (evaluate.coverage).
    Where the model is not the texture, `psnr_baked` is the PSNR with the texture that was baked from it, which is what
    Stage II and exports see. With `exposure` fitted (coverage.compare_views) `psnr_as_exposed` is the PSNR without.
    Raises DataError for views without masks and without a region.
    """
    from exmesh_graph.stage1.render import render_carrier

    chosen = spread(len(views), max_views)
    if not views.has_masks:
        region_rows(region, views, chosen)
    shown, alpha = render_carrier(carrier, views.subset(chosen), blended=views.has_masks)
    compared = compare_views(list(shown), list(alpha), carrier, views, chosen, region, exposure)
    held_out = compared.figures(views.names)
    if exposure == "fitted":
        fixed = compare_views(list(shown), list(alpha), carrier, views, chosen, region)
        held_out["psnr_as_exposed"] = float(np.mean(fixed.psnr))
    headline: list[dict[str, Any]] = [
        {
            "label": "Held-out PSNR, Stage I" + exposure_words(exposure),
            "value": held_out["psnr"],
            "unit": "dB",
            "better": "higher",
            "series": "held-out PSNR",
            "over": {"vertices": len(carrier.vertices)},
        }
    ]
    if not views.has_masks:
        headline += share_figures(held_out, ", Stage I")
    if isinstance(carrier, Stage1State) and carrier.appearance != "uv_texture":
        plain = replace(carrier, appearance="uv_texture", model={})
        baked, alpha = render_carrier(plain, views.subset(chosen), blended=views.has_masks)
        again = compare_views(list(baked), list(alpha), carrier, views, chosen, region, exposure)
        held_out["psnr_baked"] = float(np.mean(again.psnr))
    return CarrierScores({"headline": headline, "held_out": held_out}, compared)


def carrier_pairs(scores: CarrierScores, views: Views, count: int) -> ScoredViews:
    """`count` of the scored views."""
    compared = scores.compared
    names = [views.names[i] for i in compared.rows]
    pairs = held_out_pairs(scores.values, compared.pairs, names, count)
    return pairs_for_pictures(pairs, views, compared.rows, compared.marks)


def score_stage(
    carrier: Carrier,
    views: Views | None,
    truth: SceneTruth | None,
    region: Region | None = None,
    *,
    samples: int = 10_000,
    max_views: int = 8,
    seed: int = 0,
) -> dict[str, Any]:
    """`stages`: Chamfer (with a truth) and held-out PSNR, as points of the report's charts only.

    No PSNR without views, nor where nothing says which of their pixels count: neither masks nor a `region`.
    """
    values: dict[str, Any] = {"faces": len(carrier.faces), "vertices": len(carrier.vertices)}
    stages: list[dict[str, Any]] = []
    if truth is not None:
        stages += score_mesh(carrier, truth, samples=samples, seed=seed)["headline"]
    if views is not None and (views.has_masks or region is not None):
        stages += score_carrier(carrier, views, max_views=max_views, region=region).values["headline"]
    values["stages"] = [stage for stage in stages if stage.get("series")]
    return values
