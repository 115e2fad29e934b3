"""Scoring a finished asset: held-out views, relit views, materials, each beside its floor.

The floor is what an uninformed guess would score: a uniformly gray object (albedo 0.5, roughness 0.5) of the true
shape, under uniform light of the training images' level for held-out views, and under the true lights for relit ones.
All image figures are of display colours over black, on whole images; where the data has no masks, held-out views are
compared where a `Region` says (evaluate.coverage), and the floor is one gray all over it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from exmesh_graph.evaluate.coverage import compare_flat, compare_views, region_rows, share_figures
from exmesh_graph.evaluate.metrics.material import albedo_psnr, albedo_scale, roughness_mse
from exmesh_graph.evaluate.renders import (
    GRAY_ALBEDO,
    GRAY_ROUGHNESS,
    Progress,
    Renderer,
    Steps,
    gray_object,
    shown,
    take,
)
from exmesh_graph.evaluate.scores import Pictures, compare, headline_figure, held_out_pairs, pairs_for_pictures
from exmesh_graph.evaluate.settings import Quality, ScaleRule
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import display
from exmesh_graph.io.shots import spread
from exmesh_graph.types import Asset, Region, SceneTruth, ScoredViews, Views


@dataclass
class AssetScores:
    """Figures, and the images they were computed from (all display values, lists over the scored views).

    values  the content of the Metrics artifact
    views   indices of the scored views;  held_out, relit[light]: (ours, truth) per view;  marks as in ScoredViews
    albedo, roughness: (ours, truth) per view, albedo scaled and sRGB-encoded
    albedo_maps  (ours, truth, coverage) [M, H, W, 3], linear, unscaled
    indirect  (view, the view as rendered, its interreflected light alone), None where no bounces are rendered
    """

    values: dict[str, Any]
    views: list[int]
    held_out: Pictures = field(default_factory=list)
    marks: list[np.ndarray] = field(default_factory=list)
    relit: dict[str, Pictures] = field(default_factory=dict)
    albedo: Pictures = field(default_factory=list)
    roughness: Pictures = field(default_factory=list)
    albedo_maps: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    indirect: tuple[int, np.ndarray, np.ndarray] | None = None


def score_asset(
    asset: Asset,
    views: Views,
    truth: SceneTruth | None = None,
    train: Views | None = None,
    *,
    max_views: int = 0,
    quality: Quality | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    rule: ScaleRule = "median",
    region: Region | None = None,
) -> AssetScores:
    """Score `asset` on held-out `views`, and on `truth`'s relit images and materials where there are any.

    train      the training views, for the level of the floor's uniform light; the scored views stand in without it
    max_views  score this many, evenly spread; 0: all
    rule       how the albedo's scale is found (metrics.material)
    region     what counts in views without masks; DataError where these come without one
    """
    quality = quality or Quality()
    chosen = spread(len(views), max_views)
    if not views.has_masks:
        region_rows(region, views, chosen)
    known = {name: index for index, name in enumerate(truth.names)} if truth is not None else {}
    paired = [(i, known[views.names[i]]) for i in chosen if views.names[i] in known]
    lights = sorted(truth.relit) if truth is not None and paired else []
    extra = 2 if quality.bounces else 0
    guessed = len(chosen) if views.has_masks else 0
    steps = Steps(progress, len(chosen) + guessed + 3 * len(lights) * len(paired) + extra)
    # without masks a pixel is the surface at its centre, with nothing in it of what stands behind
    own = quality if views.has_masks else quality.replaced(supersampling=1)
    ours = Renderer(asset, views, own, steps, seed)
    # The guess scores about 20 dB: neither its silhouette nor its rough highlights need many samples.
    coarse = quality.replaced(supersampling=1, specular_samples=max(1, quality.specular_samples // 2))
    guess = Renderer(gray_object(asset, truth), views, coarse, steps, seed)
    scores = AssetScores({"headline": [], "floor": {}}, chosen)

    rendered = ours.render(chosen)
    if quality.bounces:
        scores.indirect = _indirect(ours, chosen[len(chosen) // 2])
    _score_held_out(scores, rendered, guess, views, chosen, train, region, asset)
    floor = scores.values["floor"]["held_out_psnr"]
    headline: list[dict[str, Any]] = scores.values["headline"]
    headline.append(headline_figure("Held-out PSNR", scores.values["held_out"]["psnr"], "dB", floor, "held-out PSNR"))
    if not views.has_masks:
        headline += share_figures(scores.values["held_out"])
    if truth is None or not paired:
        return scores
    rows = [chosen.index(i) for i, _ in paired]
    scales = _score_materials(scores, take(rendered, rows), views, truth, paired, headline, rule)
    if lights:
        _score_relit(scores, ours, guess, truth, lights, paired, scales)
        relit, floor = scores.values["relit"], scores.values["floor"]["relit_psnr"]
        headline[1:1] = [
            headline_figure("Relit PSNR", relit["psnr"], "dB", floor, "relit PSNR"),
            headline_figure("Relit PSNR, albedo unscaled", relit["psnr_unscaled"], "dB", None, ""),
        ]
    return scores


def asset_pairs(scores: AssetScores, views: Views, count: int) -> ScoredViews:
    """`count` held-out views and one of each light, of base colour, of roughness and of the interreflected light."""
    pairs = held_out_pairs(scores.values, scores.held_out, [views.names[i] for i in scores.views], count)

    def add(kind: str, name: str, pictures: Pictures, figures: dict[str, Any]) -> None:
        for k in spread(len(pictures), 1):
            pairs.append(({"kind": kind, "name": name, "number": k, "figures": figures}, *pictures[k]))

    for light, pictures in scores.relit.items():
        of_light = scores.values["relit"]["per_light"][light]
        add("relit", light, pictures, {key: of_light[key] for key in ("psnr", "psnr_unscaled", "psnr_floor")})
    add("albedo", "", scores.albedo, {"scale": scores.values.get("material", {}).get("albedo_scale")})
    add("roughness", "", scores.roughness, {})
    if scores.indirect is not None:
        view, whole, alone = scores.indirect
        add("indirect", views.names[view], [(whole, alone)], {})
    return pairs_for_pictures(pairs, views, scores.views, scores.marks)


def _indirect(ours: Renderer, view: int) -> tuple[int, np.ndarray, np.ndarray]:
    """The view twice with the same random rays, with all bounces and with none: their difference."""
    whole, direct = ours.render([view]), ours.render([view], direct=True)
    alone = np.maximum(whole.images[0] - direct.images[0], 0)
    return view, shown(whole)[0], display(alone, whole.alpha[0])


def _score_held_out(
    scores: AssetScores,
    rendered: Any,
    guess: Renderer,
    views: Views,
    chosen: Sequence[int],
    train: Views | None,
    region: Region | None,
    asset: Asset,
) -> None:
    """Fill `held_out` and its floor."""
    compared = compare_views(shown(rendered), list(rendered.alpha), asset, views, chosen, region)
    if views.has_masks:
        gray = guess.render(chosen)  # light is linear: the level scales the image
        lit = train if train is not None and train.has_masks else views
        level = _uniform_level(lit.images, lit.alpha > 0.5, gray)
        flat = [display(level * image, alpha) for image, alpha in zip(gray.images, gray.alpha, strict=True)]
        floor = compare_views(flat, list(gray.alpha), asset, views, chosen)
    else:
        assert region is not None
        floor, radiance = compare_flat(views, chosen, region)
        level = radiance / GRAY_ALBEDO
    scores.views, scores.held_out, scores.marks = compared.rows, compared.pairs, compared.marks
    scores.values["held_out"] = compared.figures(views.names)
    scores.values["floor"] |= {
        "held_out_psnr": float(np.mean(floor.psnr)),
        "held_out_ssim": float(np.mean(floor.ssim)),
        "light_level": level,
    }


def _uniform_level(photographs: np.ndarray, inside: np.ndarray, gray: Any) -> float:
    """Radiance of the uniform light under which the gray object is as bright as the photographs, on average."""
    under_one = float(gray.images[gray.alpha > 0.5].mean())
    return float(photographs[inside].mean()) / max(under_one, 1e-6)


def _score_materials(
    scores: AssetScores,
    rendered: Any,
    views: Views,
    truth: SceneTruth,
    paired: Sequence[tuple[int, int]],
    headline: list[dict[str, Any]],
    rule: ScaleRule,
) -> _AlbedoScales:
    """Fill `material`; returns the scales that bring our albedo and the gray guess's to the truth's level."""
    cameras, rows = [i for i, _ in paired], [k for _, k in paired]
    material: dict[str, Any] = {}
    floor: dict[str, Any] = scores.values["floor"]
    scales = _AlbedoScales(None, None)
    if truth.albedo is not None:
        true = truth.albedo[list(rows)]
        covered = _coverage(views, cameras, true)
        gray = np.full_like(true, GRAY_ALBEDO)
        true, weight = _with_leaks(true, covered, rendered.alpha)
        scale = albedo_scale(rendered.albedo, true, covered, rule)
        gray_scale = albedo_scale(gray, true, covered, rule)
        scores.albedo_maps = (rendered.albedo, true, covered)
        scales = _AlbedoScales(scale, gray_scale)
        material["albedo_scale"] = scale.tolist()
        for space in ("linear", "srgb"):

            def score(
                albedo: np.ndarray, factor: np.ndarray, weight: np.ndarray = weight, srgb: bool = space == "srgb"
            ) -> float:
                triples = zip(albedo, true, weight, strict=True)
                return float(np.mean([albedo_psnr(a, t, c, factor, srgb=srgb) for a, t, c in triples]))

            material[f"albedo_psnr_{space}"] = score(rendered.albedo, scale)
            material[f"albedo_psnr_{space}_unscaled"] = score(rendered.albedo, np.ones(3))
            floor[f"albedo_psnr_{space}"] = score(gray, gray_scale, covered)
        figure, guess = material["albedo_psnr_linear"], floor["albedo_psnr_linear"]
        headline.append(headline_figure("Albedo PSNR (linear)", figure, "dB", guess, "albedo PSNR"))
        scores.albedo = [
            (linear_to_srgb(np.clip(a * scale, 0, 1)) * c[..., None], linear_to_srgb(t) * c[..., None])
            for a, t, c in zip(rendered.albedo, true, covered, strict=True)
        ]
    if truth.roughness is not None:
        true = truth.roughness[list(rows)]
        covered = _coverage(views, cameras, true)
        true, weight = _with_leaks(true, covered, rendered.alpha)
        # 0 is no wrong roughness where a surface is glossy: what is missing is as wrong as can be
        missing = (rendered.alpha == 0) & (covered > 0.5)
        ours = np.where(missing, true < 0.5, rendered.roughness).astype(np.float32)
        triples = list(zip(ours, true, weight, strict=True))
        material["roughness_mse"] = float(np.mean([roughness_mse(r, t, c) for r, t, c in triples]))
        guesses = [roughness_mse(np.full_like(t, GRAY_ROUGHNESS), t, c) for t, c in zip(true, covered, strict=True)]
        floor["roughness_mse"] = float(np.mean(guesses))
        headline.append(
            headline_figure(
                "Roughness MSE", material["roughness_mse"], "", floor["roughness_mse"], "roughness MSE", "lower"
            )
        )
        scores.roughness = [(r * c, t * c) for r, t, c in triples]
    if material:
        scores.values["material"] = material
    return scales


def _with_leaks(maps: np.ndarray, covered: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The true maps, 0 outside their coverage, and what both are weighed by: there our own coverage, `alpha`."""
    inside = covered > 0
    true = np.where(inside[..., None] if maps.ndim == 4 else inside, maps, 0).astype(maps.dtype)
    return true, np.where(inside, covered, alpha)


def _coverage(views: Views, cameras: Sequence[int], maps: np.ndarray) -> np.ndarray:
    """Where the true maps [N, H, W(, 3)] hold a value: the views' masks; without masks, where a map is not 0."""
    if views.has_masks:
        return views.alpha[list(cameras)]
    filled = maps > 0 if maps.ndim == 3 else (maps > 0).any(axis=-1)
    return np.asarray(filled, np.float32)


def _score_relit(
    scores: AssetScores,
    ours: Renderer,
    guess: Renderer,
    truth: SceneTruth,
    lights: Sequence[str],
    paired: Sequence[tuple[int, int]],
    scales: _AlbedoScales,
) -> None:
    """Fill `relit`: per light and mean, with and without the albedo scale, which is never fitted to relit images.

    The gray guess gets a scale of its own by the same rule, so that the margin above it owes nothing to the scale.
    """
    cameras, rows = [i for i, _ in paired], [k for _, k in paired]
    per_light: dict[str, dict[str, Any]] = {}
    for light in lights:
        environment, photographs = truth.relit[light]
        true = [display(photographs[k], truth.relit_alpha[light][k]) for k in rows]
        figures: dict[str, Any] = {}
        plain = shown(ours.render(cameras, environment=environment))
        scaled = plain
        if scales.ours is not None:
            scaled = shown(ours.render(cameras, environment=environment, scale=scales.ours))
        gray = shown(guess.render(cameras, environment=environment, scale=scales.gray))
        for key, images in (("", scaled), ("_unscaled", plain), ("_floor", gray)):
            db, structure = compare(images, true)
            figures |= {f"psnr{key}": float(np.mean(db)), f"ssim{key}": float(np.mean(structure))}
            if not key:
                names = [truth.names[k] for k in rows]
                figures["psnr_per_view"] = dict(zip(names, db, strict=True))
        per_light[light] = figures
        scores.relit[light] = list(zip(scaled, true, strict=True))

    def mean(key: str) -> float:
        return float(np.mean([figures[key] for figures in per_light.values()]))

    scores.values["relit"] = {
        "psnr": mean("psnr"),
        "psnr_unscaled": mean("psnr_unscaled"),
        "ssim": mean("ssim"),
        "per_light": per_light,
    }
    scores.values["floor"] |= {"relit_psnr": mean("psnr_floor"), "relit_ssim": mean("ssim_floor")}


class _AlbedoScales(NamedTuple):
    """Factors [3] onto albedo, of our asset and of the gray guess; None where no true albedo is known."""

    ours: np.ndarray | None
    gray: np.ndarray | None
