"""Stanford-ORB's figures (Kuang et al. 2023), by the formulas of its evaluation, quirks included.

Scored at 512 x 512: pictures of 2048 x 2048 are averaged over 4 x 4. The mask, > 0.5 after that, is eroded by 5 x 5.
For relit pictures and albedo each channel is first multiplied by sum(truth estimate) / sum(estimate^2) over the eroded
mask, per image; for novel views under the training light it is not.

psnr_h    both images, masked, times m = mean(sRGB(clip(truth, 0, 1))) / mean(clip(truth, 0, 1)), over the whole image
          then clipped to [0, 4]; -10 log10 of the mean squared difference. Quirks: the peak counts as 1 though values
          reach 4, and the mean is over the whole image, so that a small object scores higher.
psnr_l    clipped to [0, 1] and sRGB-encoded, then as above
ssim      window 3 x 3 (Gaussian, sigma 1.5), of the sRGB images, masked, mean over the whole image
lpips     VGG. Quirk: the sRGB images are sRGB-encoded a second time.
          Quirk: neither PSNR falls below that of a silhouette of value 0.5; a failed estimate counts as that.
albedo    as psnr_l, ssim and lpips, but without the encoding: all linear (LPIPS is encoded once)
depth     along z; one least-squares factor per scene; mean over the whole image of the masked squared error; x 1e3
normal    mean of 1 - cosine over the eroded mask, camera space
shape     mean squared distance from the true mesh's vertices to 30 000 samples of ours, and back. The benchmark's JSON
          holds their mean; its tables hold 2e3 times that. Quirk: vertices of one mesh against samples of the other,
          so the figure has a floor from the sampling, and a truth with uneven vertices weighs dense parts more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.metrics.image import ssim_map
from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.renders import Progress, Steps
from exmesh_graph.evaluate.scores import benchmark_row, points_to_dataset
from exmesh_graph.evaluate.settings import OrbParams
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.normalise import frame_scale
from exmesh_graph.io.shots import spread
from exmesh_graph.types import Asset, Frame, LitViews, SceneTruth, Views

SHAPE_SAMPLES = 30_000


def score_orb(
    asset: Asset,
    views: Views,
    novel: LitViews,
    truth: SceneTruth,
    frame: Frame,
    p: OrbParams,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Figures of a capture, its row of the paper's table, and albedo, which that table does not have.

    views  the capture's test views, rendered under the asset's own light
    novel  those of the object's other captures, each rendered under its own measured light
    """
    from exmesh_graph.stage2.render import render_transport, render_under
    from exmesh_graph.stage2.scene import Body, Lighting

    lpips = Lpips.from_file(p.lpips) if p.lpips else None
    tests, others = spread(len(views), p.max_views), spread(len(novel), p.max_views)
    steps = Steps(progress, len(tests) + len(others))
    body = Body(asset, render_transport(asset, p.bounces, p.directions))

    def render(where: Views, chosen: list[int], environment: np.ndarray | None) -> Any:
        cameras = (where.intrinsics[chosen], where.camera_to_world[chosen], where.height, where.width)
        (rendered,) = render_under(
            body, *cameras, [Lighting(environment)], supersampling=p.supersampling,
            specular_samples=p.specular_samples, seed=seed, progress=steps,
        )  # fmt: skip
        return rendered

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
    return values | benchmark_row("stanford_orb", p.scene, row, lower)


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


def view_scores(
    image: np.ndarray, truth: np.ndarray, mask: np.ndarray, *, relit: bool, lpips: Lpips | None = None
) -> dict[str, float]:
    """psnr_h, psnr_l, ssim (and lpips) of linear images [H, W, 3] with the truth's mask [H, W].

    `relit`: take out the factor per channel, as for new lights; novel views under the training light: False.
    """
    inside = eroded(mask)
    ours, true = _masked(image, truth, inside)
    middle = np.clip(true, 0, 1).mean()
    level = linear_to_srgb(np.clip(true, 0, 1)).mean() / middle if middle > 1e-8 else 1.0
    high, _, _ = _psnr(ours * level, true * level, inside, top=4.0, encoded=False, scaled=relit)
    low, ours, true = _psnr(ours, true, inside, top=1.0, encoded=True, scaled=relit)
    return {"psnr_h": high, "psnr_l": low} | _structure(ours, true, inside, lpips)


def albedo_scores(
    albedo: np.ndarray, truth: np.ndarray, mask: np.ndarray, *, lpips: Lpips | None = None
) -> dict[str, float]:
    """psnr, ssim (and lpips) of linear albedo [H, W, 3] after a least-squares factor per channel and image."""
    inside = eroded(mask)
    value, ours, true = _psnr(*_masked(albedo, truth, inside), inside, top=1.0, encoded=False, scaled=True)
    return {"psnr": value} | _structure(ours, true, inside, lpips)


def depth_error(depths: Sequence[np.ndarray], truths: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> float:
    """The depth figure of a scene, x 1e3: z-depths [H, W] of all its views, one factor for all of them."""
    insides = [eroded(mask) for mask in masks]
    ours = [np.where(inside, depth, 0).astype(np.float64) for depth, inside in zip(depths, insides, strict=True)]
    true = [np.where(inside, depth, 0).astype(np.float64) for depth, inside in zip(truths, insides, strict=True)]
    # A view without any depth takes part as depth 1.
    ours = [a if (a**2).sum() > 1e-6 else inside.astype(np.float64) for a, inside in zip(ours, insides, strict=True)]
    below = sum((a * a).sum() for a in ours)
    if below <= 0:
        raise NumericsError("no view shows the object, so depth cannot be scored")
    scale = sum((a * b).sum() for a, b in zip(ours, true, strict=True)) / below
    return 1e3 * float(np.mean([((scale * a - b) ** 2).mean() for a, b in zip(ours, true, strict=True)]))


def normal_error(normals: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Mean of 1 - cosine between camera-space normals [H, W, 3] over the eroded mask; both are normalised first."""
    inside = eroded(mask)
    if not inside.any():
        raise NumericsError("the mask is empty after erosion, so normals cannot be scored")
    a, b = (x / (np.linalg.norm(x, axis=-1, keepdims=True) + 1e-6) for x in (normals, truth))
    return float((1 - (a * b).sum(-1))[inside].mean())


def shape_error(
    vertices: np.ndarray,
    faces: np.ndarray,
    true_vertices: np.ndarray,
    *,
    samples: int = SHAPE_SAMPLES,
    seed: int = 0,
) -> float:
    """The shape figure as the benchmark's tables give it, 2e3 times the mean of the two mean squared distances."""
    ours, _, _ = sample_surface(vertices, faces, samples, seed)
    truth = np.asarray(true_vertices, np.float64)
    there, back = cKDTree(ours).query(truth)[0], cKDTree(truth).query(ours)[0]
    return 1e3 * float((there**2).mean() + (back**2).mean())


def eroded(mask: np.ndarray) -> np.ndarray:
    """bool [H, W]: mask > 0.5, eroded by 5 x 5; beyond the picture's border counts as inside."""
    return binary_erosion(np.asarray(mask) > 0.5, np.ones((5, 5), bool), border_value=1)


def _geometry(
    asset: Asset, views: Views, truth: SceneTruth, frame: Frame, rows: list[tuple[int, int, int]],
    normals: np.ndarray, seed: int,
) -> dict[str, float | None]:  # fmt: skip
    """Depth x 1e3, normal and shape; None where the truth lacks the map."""
    errors: dict[str, float | None] = {"depth": None, "normal": None, "shape": None}
    masks = [views.alpha[i] for _, i, _ in rows]
    if truth.depth is not None and rows:
        # The benchmark's depth is in the data set's units; one factor per scene is taken out of the estimate only.
        scale = frame_scale(frame)
        depths = [depth_map(asset, views, i) for _, i, _ in rows]
        errors["depth"] = depth_error(depths, [truth.depth[k] * scale for _, _, k in rows], masks)
    if truth.normal is not None and rows:
        cameras = [normals[n] @ views.camera_to_world[i, :3, :3] for n, i, _ in rows]
        triples = zip(cameras, (truth.normal[k] for _, _, k in rows), masks, strict=True)
        errors["normal"] = float(np.mean([normal_error(*triple) for triple in triples]))
    if truth.mesh_vertices is not None:
        ours, true = (points_to_dataset(v, frame) for v in (asset.vertices, truth.mesh_vertices))
        errors["shape"] = shape_error(ours, asset.faces, true, seed=seed)
    return errors


def _means(scores: list[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([score[name] for score in scores])) for name in scores[0]}


def _masked(image: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if image.shape != truth.shape or image.shape[:2] != inside.shape:
        raise NumericsError(f"cannot compare images of shapes {image.shape} and {truth.shape}, mask {inside.shape}")
    if not np.isfinite(image).all():
        raise NumericsError("an image holds NaN or Inf", fix="look at the step that rendered it")
    weight = inside[..., None].astype(np.float64)
    return image * weight, np.maximum(truth * weight, 0)


def _psnr(
    image: np.ndarray, truth: np.ndarray, inside: np.ndarray, *, top: float, encoded: bool, scaled: bool
) -> tuple[float, np.ndarray, np.ndarray]:
    """(PSNR, the two images it compares)."""
    if scaled:
        a, b = image[inside], truth[inside]
        below = (a * a).sum(0)
        image = image * np.where(below > 1e-6, (a * b).sum(0) / np.where(below > 1e-6, below, 1), 0)
    image, truth = np.clip(image, 0, top), np.clip(truth, 0, top)
    if encoded:
        image, truth = linear_to_srgb(image), linear_to_srgb(truth)
    gray = 0.5 * inside[..., None]
    error = min(((image - truth) ** 2).mean(), ((gray - truth) ** 2).mean())
    return (min(100.0, float(-10 * np.log10(error))) if error > 0 else 100.0), image, truth


def _structure(image: np.ndarray, truth: np.ndarray, inside: np.ndarray, lpips: Lpips | None) -> dict[str, float]:
    scores = {"ssim": float(ssim_map(image, truth, radius=1, mode="mirror").mean())}
    if lpips is not None:
        weight = inside[..., None]
        scores["lpips"] = lpips(linear_to_srgb(image) * weight, linear_to_srgb(truth) * weight)
    return scores
