"""Scoring a scene of a published benchmark: what the nodes `benchmark.*` put into their Metrics.

`benchmark` of each is one scene's row of the paper's table, {table, scene, row: {column: figure}} with the columns of
`report.published`; `exmesh run` and `exmesh sweep` average the rows over scenes and print them beside the published
ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.metrics.material import ScaleRule, albedo_table
from exmesh_graph.evaluate.renders import Progress, Quality
from exmesh_graph.evaluate.scores import AssetScores, compare, score_asset
from exmesh_graph.evaluate.scores_mesh import score_carrier
from exmesh_graph.io.normalise import frame_scale
from exmesh_graph.types import Asset, Carrier, Frame, Mesh, SceneTruth, Views


def benchmark(table: str, scene: str, row: dict[str, float | None], better: dict[str, str]) -> dict[str, Any]:
    """{benchmark, headline}: the row, and its figures as headlines named by their columns."""
    figures = [
        {"label": f"{table} {name}", "value": value, "unit": "", "better": better.get(name, "higher")}
        for name, value in row.items()
        if value is not None
    ]
    return {"benchmark": {"table": table, "scene": scene, "row": row}, "headline": figures}


def score_dtu(
    mesh: Mesh, frame: Frame, folder: Path, scan: int, views: Sequence[Views] = (), *, seed: int = 0
) -> dict[str, Any]:
    """DTU's Chamfer distance in mm, culled by the views' masks (where they have any) and unculled.

    The row's figure is the culled one where it is known. DTU's photographs are 1600 pixels wide: the 24 pixels by which
    masks are dilated shrink with ours.
    """
    from exmesh_graph.evaluate.metrics.dtu import CULL_RADIUS, cull, dtu_chamfer, read_truth

    truth = read_truth(folder, scan)
    vertices = points_to_dataset(mesh.vertices, frame)
    values: dict[str, Any] = {"unculled": asdict(dtu_chamfer(vertices, mesh.faces, truth, seed=seed))}
    masked = [view for view in views if view.has_masks]
    if masked:
        masks = np.concatenate([view.alpha[view.masked] for view in masked])
        projections = np.concatenate([(v.intrinsics @ v.world_to_camera[:, :3])[v.masked] for v in masked])
        faces = cull(mesh.vertices, mesh.faces, masks, projections, radius=CULL_RADIUS * masked[0].width / 1600)
        values["culled"] = asdict(dtu_chamfer(vertices, faces, truth, seed=seed))
    best = values.get("culled", values["unculled"])
    row: dict[str, float | None] = {"CD": best["chamfer"], "vertices": float(len(mesh.vertices))}
    return values | benchmark("dtu", str(scan), row, {"CD": "lower", "vertices": ""})


def score_surface(
    mesh: Mesh, truth: SceneTruth, views: Views, frame: Frame, scene: str, *, samples: int = 100_000, seed: int = 0
) -> dict[str, Any]:
    """NeRF-Synthetic's Chamfer distances, visible and full surface, in thousandths of the data set's unit, and, for a
    carrier, its held-out PSNR.

    Raises DataError without a true mesh.
    """
    from exmesh_graph.evaluate.metrics.visible import full_surface, visible_surface

    if truth.mesh_vertices is None or truth.mesh_faces is None:
        raise DataError(
            "the scene has no true mesh", where=scene, expected="mesh.obj or mesh.ply in the scene's folder",
            fix="export it from the scene's .blend file, in its world and units",
        )  # fmt: skip
    both = (mesh.vertices, mesh.faces, truth.mesh_vertices, truth.mesh_faces)
    unit = 1 / frame_scale(frame)
    size = (views.width, views.height)
    seen = visible_surface(*both, views.intrinsics, views.camera_to_world, size, unit=unit, samples=samples, seed=seed)
    whole = full_surface(*both, unit=unit, samples=samples, seed=seed)
    psnr = score_carrier(mesh, views).values["held_out"]["psnr"] if isinstance(mesh, Carrier) else None
    row: dict[str, float | None] = {
        "CD visible": seen.chamfer, "CD full": whole.chamfer, "PSNR": psnr,
        "vertices": float(len(mesh.vertices)),
    }  # fmt: skip
    found = {"visible": asdict(seen), "full": asdict(whole)}
    return found | benchmark("nerf_synthetic", scene, row, {"CD visible": "lower", "CD full": "lower", "vertices": ""})


def score_synthetic4relight(
    asset: Asset,
    views: Views,
    truth: SceneTruth,
    train: Views | None,
    scene: str,
    *,
    rule: ScaleRule = "median",
    lpips: Lpips | None = None,
    max_views: int = 0,
    quality: Quality | None = None,
    progress: Progress | None = None,
) -> AssetScores:
    """The scores of `score_asset`, every published albedo figure, and the row of the paper's table.

    Albedo is compared linear, over black, whole image, as IRGS does; relit pictures get the albedo's scale.
    """
    scores = score_asset(
        asset, views, truth, train, max_views=max_views, quality=quality, progress=progress, rule=rule
    )  # fmt: skip
    if scores.albedo_maps is None or not scores.relit or not scores.roughness:
        raise DataError("the scene lacks albedo, roughness or relit pictures of its test views", where=scene,
                        fix="load it with data.synthetic4relight, which says what is missing")  # fmt: skip
    ours, true, covered = scores.albedo_maps
    scale = np.array(scores.values["material"]["albedo_scale"])
    weight = covered[..., None]
    albedo = list(zip(np.clip(ours * scale, 0, 1) * weight, np.clip(true, 0, 1) * weight, strict=True))
    relit = [pair for pairs in scores.relit.values() for pair in pairs]
    row: dict[str, float | None] = {}
    for name, pairs in (("NVS", scores.held_out), ("relight", relit), ("albedo", albedo)):
        db, structure = compare([a for a, _ in pairs], [b for _, b in pairs])
        row[f"{name} PSNR"], row[f"{name} SSIM"] = float(np.mean(db)), float(np.mean(structure))
        row[f"{name} LPIPS"] = None if lpips is None else float(np.mean([lpips(a, b) for a, b in pairs]))
    row["roughness MSE"] = scores.values["material"]["roughness_mse"]
    table = benchmark(
        "synthetic4relight", scene, row, {name: "lower" for name in row if name.endswith(("LPIPS", "MSE"))}
    )
    scores.values["albedo_rules"] = albedo_table(ours, true, covered, scene)
    scores.values["scale_rule"] = rule
    scores.values["benchmark"] = table["benchmark"]
    return scores


def points_to_dataset(points: np.ndarray, frame: Frame) -> np.ndarray:
    """Normalised points in the axes and units of the data set's files, float64 [N, 3]."""
    matrix = frame.dataset_from_scene @ frame.scene_from_normalised
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
