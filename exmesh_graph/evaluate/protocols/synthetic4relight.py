"""Scoring a scene of Synthetic4Relight: new views, relit views, albedo and roughness."""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.asset import AssetScores, score_asset
from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.metrics.material import albedo_table
from exmesh_graph.evaluate.renders import Progress
from exmesh_graph.evaluate.scores import benchmark_row, compare
from exmesh_graph.evaluate.settings import Synthetic4RelightParams
from exmesh_graph.types import Asset, SceneTruth, Views


def score_synthetic4relight(
    asset: Asset,
    views: Views,
    truth: SceneTruth,
    train: Views | None,
    p: Synthetic4RelightParams,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> AssetScores:
    """The scores of `score_asset`, every published albedo figure, and the row of the paper's table.

    Albedo is compared linear, over black, whole image, as IRGS does; relit pictures get the albedo's scale.
    """
    scores = score_asset(
        asset, views, truth, train, max_views=p.max_views, quality=p, seed=seed, progress=progress, rule=p.rule
    )  # fmt: skip
    if scores.albedo_maps is None or not scores.relit or not scores.roughness:
        raise DataError("the scene lacks albedo, roughness or relit pictures of its test views", where=p.scene,
                        fix="load it with data.synthetic4relight, which says what is missing")  # fmt: skip
    ours, true, covered = scores.albedo_maps
    scale = np.array(scores.values["material"]["albedo_scale"])
    weight = covered[..., None]
    albedo = list(zip(np.clip(ours * scale, 0, 1) * weight, np.clip(true, 0, 1) * weight, strict=True))
    lpips = Lpips.from_file(p.lpips) if p.lpips else None
    relit = [pair for pairs in scores.relit.values() for pair in pairs]
    row: dict[str, float | None] = {}
    for name, pairs in (("NVS", scores.held_out), ("relight", relit), ("albedo", albedo)):
        db, structure = compare([a for a, _ in pairs], [b for _, b in pairs])
        row[f"{name} PSNR"], row[f"{name} SSIM"] = float(np.mean(db)), float(np.mean(structure))
        row[f"{name} LPIPS"] = None if lpips is None else float(np.mean([lpips(a, b) for a, b in pairs]))
    row["roughness MSE"] = scores.values["material"]["roughness_mse"]
    table = benchmark_row(
        "synthetic4relight", p.scene, row, {name: "lower" for name in row if name.endswith(("LPIPS", "MSE"))}
    )
    scores.values["albedo_rules"] = albedo_table(ours, true, covered, p.scene)
    scores.values["scale_rule"] = p.rule
    scores.values["benchmark"] = table["benchmark"]
    return scores
