"""Scoring an asset by Stanford-ORB: novel views, novel lights, and geometry against the scan."""

from __future__ import annotations

from typing import Any

import numpy as np

from exmesh_graph.evaluate.benchmarks import benchmark, points_to_dataset
from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.metrics.stanford_orb import (
    albedo_scores,
    depth_error,
    normal_error,
    shape_error,
    view_scores,
)
from exmesh_graph.evaluate.renders import Progress, Quality, Steps
from exmesh_graph.evaluate.scores import spread
from exmesh_graph.types import Asset, Frame, LitViews, SceneTruth, Views


def score_orb(
    asset: Asset,
    views: Views,
    novel: LitViews,
    truth: SceneTruth,
    frame: Frame,
    scene: str,
    *,
    lpips: Lpips | None = None,
    max_views: int = 0,
    quality: Quality | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Figures of a capture, its row of the paper's table, and albedo, which that table does not have.

    views  the capture's test views, rendered under the asset's own light
    novel  those of the object's other captures, each rendered under its own measured light
    """
    from exmesh_graph.stage2.render import render_transport, render_views

    quality = quality or Quality()
    tests, others = spread(len(views), max_views), spread(len(novel), max_views)
    steps = Steps(progress, len(tests) + len(others))
    transport = render_transport(asset, quality.bounces, quality.directions)

    def render(where: Views, chosen: list[int], environment: np.ndarray | None) -> Any:
        cameras = (where.intrinsics[chosen], where.camera_to_world[chosen], where.height, where.width)
        return render_views(
            asset, *cameras, environment=environment, transport=transport, bounces=quality.bounces,
            supersampling=quality.supersampling, specular_samples=quality.specular_samples, seed=quality.seed,
            progress=steps,
        )  # fmt: skip

    rendered = render(views, tests, None)
    held_out = [
        view_scores(image, views.images[i], views.alpha[i], relit=False, lpips=lpips)
        for image, i in zip(rendered.images, tests, strict=True)
    ]
    assert novel.environments is not None
    relit = [
        view_scores(render(novel, [i], novel.environments[i]).images[0], novel.images[i], novel.alpha[i], relit=True,
                    lpips=lpips)
        for i in others
    ]  # fmt: skip
    values: dict[str, Any] = {"nvs": _means(held_out), "relight": _means(relit), "views": [len(tests), len(others)]}
    known = {name: k for k, name in enumerate(truth.names)}
    rows = [(n, i, known[views.names[i]]) for n, i in enumerate(tests) if views.names[i] in known]
    if truth.albedo is not None and rows:
        values["albedo"] = _means(
            [albedo_scores(rendered.albedo[n], truth.albedo[k], views.alpha[i], lpips=lpips) for n, i, k in rows]
        )
    values["geometry"] = geometry = _geometry(asset, views, truth, frame, rows, rendered.normal, seed)
    row: dict[str, float | None] = {}
    for name, figures in (("NVS", values["nvs"]), ("relight", values["relight"])):
        for label, key in (("PSNR-H", "psnr_h"), ("PSNR-L", "psnr_l"), ("SSIM", "ssim"), ("LPIPS", "lpips")):
            row[f"{name} {label}"] = figures.get(key)
    row |= {"depth": geometry["depth"], "normal": geometry["normal"], "CD": geometry["shape"]}
    lower = {name: "lower" for name in row if name.endswith(("LPIPS", "depth", "normal", "CD"))}
    return values | benchmark("stanford_orb", scene, row, lower)


def _geometry(
    asset: Asset, views: Views, truth: SceneTruth, frame: Frame, rows: list[tuple[int, int, int]],
    normals: np.ndarray, seed: int,
) -> dict[str, float | None]:  # fmt: skip
    """Depth x 1e3, normal and shape; None where the truth lacks the map."""
    found: dict[str, float | None] = {"depth": None, "normal": None, "shape": None}
    masks = [views.alpha[i] for _, i, _ in rows]
    if truth.depth is not None and rows:
        # The benchmark's depth is in the data set's units; one factor per scene is taken out of the estimate only.
        scale = _scene_units(frame)
        depths = [depth_map(asset, views, i) for _, i, _ in rows]
        found["depth"] = depth_error(depths, [truth.depth[k] * scale for _, _, k in rows], masks)
    if truth.normal is not None and rows:
        cameras = [normals[n] @ views.camera_to_world[i, :3, :3] for n, i, _ in rows]
        triples = zip(cameras, (truth.normal[k] for _, _, k in rows), masks, strict=True)
        found["normal"] = float(np.mean([normal_error(*triple) for triple in triples]))
    if truth.mesh_vertices is not None:
        ours, true = (points_to_dataset(v, frame) for v in (asset.vertices, truth.mesh_vertices))
        found["shape"] = shape_error(ours, asset.faces, true, seed=seed)
    return found


def depth_map(mesh: Any, views: Views, index: int) -> np.ndarray:
    """Depth float64 [H, W] along the camera's z axis at pixel centres; 0 where the ray misses."""
    from exmesh_graph.rays.embree import EmbreeTracer

    pose = views.camera_to_world[index]
    x, y = np.meshgrid(np.arange(views.width) + 0.5, np.arange(views.height) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(views.intrinsics[index]).T
    origins = np.broadcast_to(pose[:3, 3], local.shape)
    hits = EmbreeTracer(mesh.vertices, mesh.faces).closest_hit(origins, local @ pose[:3, :3].T)
    # The rays' z component in the camera is 1, so their parameter is the depth.
    return np.where(hits.face >= 0, hits.t, 0.0).reshape(views.height, views.width)


def _scene_units(frame: Frame) -> float:
    from exmesh_graph.io.normalise import frame_scale

    return frame_scale(frame)


def _means(scores: list[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([score[name] for score in scores])) for name in scores[0]}
