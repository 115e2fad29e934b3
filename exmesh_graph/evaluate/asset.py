"""Scoring a finished asset: held-out views, relit views, materials, each beside its floor.

The floor is what an uninformed guess would score: a uniformly gray object (albedo 0.5, roughness 0.5) of the true
shape, under uniform light of the training images' level for held-out views, and under the true lights for relit ones.
All image figures are of display colours over black, on whole images; where the data has no masks they are taken
inside our own silhouette.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

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
from exmesh_graph.types import Asset, SceneTruth, ScoredViews, Views


@dataclass
class AssetScores:
    """Figures, and the images they were computed from (all display values, lists over the scored views).

    values  the content of the Metrics artifact
    views   indices of the scored views;  held_out, relit[light]: (ours, truth) per view
    albedo, roughness: (ours, truth) per view, albedo scaled and sRGB-encoded
    albedo_maps  (ours, truth, coverage) [M, H, W, 3], linear, unscaled
    indirect  (view, the view as rendered, its interreflected light alone), None where no bounces are rendered
    """

    values: dict[str, Any]
    views: list[int]
    held_out: Pictures = field(default_factory=list)
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
) -> AssetScores:
    """Score `asset` on held-out `views`, and on `truth`'s relit images and materials where there are any.

    train      the training views, for the level of the floor's uniform light; the scored views stand in without it
    max_views  score this many, evenly spread; 0: all
    rule       how the albedo's scale is found (metrics.material)
    """
    quality = quality or Quality()
    chosen = spread(len(views), max_views)
    known = {name: index for index, name in enumerate(truth.names)} if truth is not None else {}
    paired = [(i, known[views.names[i]]) for i in chosen if views.names[i] in known]
    lights = sorted(truth.relit) if truth is not None and paired else []
    extra = 2 if quality.bounces else 0
    steps = Steps(progress, len(chosen) * 2 + 3 * len(lights) * len(paired) + extra)
    ours = Renderer(asset, views, quality, steps, seed)
    # The guess scores about 20 dB: neither its silhouette nor its rough highlights need many samples.
    coarse = quality.replaced(supersampling=1, specular_samples=max(1, quality.specular_samples // 2))
    guess = Renderer(gray_object(asset, truth), views, coarse, steps, seed)
    scores = AssetScores({"headline": [], "floor": {}}, chosen)

    rendered = ours.render(chosen)
    if quality.bounces:
        scores.indirect = _indirect(ours, chosen[len(chosen) // 2])
    floor = _score_held_out(scores, rendered, guess, views, chosen, train)
    headline: list[dict[str, Any]] = scores.values["headline"]
    headline.append(headline_figure("Held-out PSNR", scores.values["held_out"]["psnr"], "dB", floor, "held-out PSNR"))
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
    return pairs_for_pictures(pairs, views, scores.views)


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
) -> float:
    """Fill `held_out`; returns the floor."""
    pictures = shown(rendered)
    true = [display(views.images[i], views.alpha[i]) for i in chosen]
    gray = guess.render(chosen)  # light is linear: the level scales the image
    lit = train if train is not None and train.has_masks else views
    if lit.has_masks:
        level = _uniform_level(lit.images, lit.alpha > 0.5, gray)
    else:  # the object's pixels are known from our silhouettes only
        level = _uniform_level(views.images[list(chosen)], rendered.alpha > 0.5, gray)
    flat = [display(level * image, alpha) for image, alpha in zip(gray.images, gray.alpha, strict=True)]
    if not views.has_masks:
        true = [image * alpha[..., None] for image, alpha in zip(true, rendered.alpha, strict=True)]
        flat = [image * alpha[..., None] for image, alpha in zip(flat, rendered.alpha, strict=True)]
    scores.held_out = list(zip(pictures, true, strict=True))
    db, structure = compare(pictures, true)
    floor_db, floor_structure = compare(flat, true)
    names = [views.names[i] for i in chosen]
    scores.values["held_out"] = {
        "psnr": float(np.mean(db)),
        "ssim": float(np.mean(structure)),
        "psnr_per_view": dict(zip(names, db, strict=True)),
        "ssim_per_view": dict(zip(names, structure, strict=True)),
        "region": "whole image, over black" if views.has_masks else "inside our silhouette",
        "views": len(names),
    }
    floor = float(np.mean(floor_db))
    scores.values["floor"] |= {
        "held_out_psnr": floor,
        "held_out_ssim": float(np.mean(floor_structure)),
        "light_level": level,
    }
    return floor


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
        scale = albedo_scale(rendered.albedo, true, covered, rule)
        gray_scale = albedo_scale(gray, true, covered, rule)
        scores.albedo_maps = (rendered.albedo, true, covered)
        scales = _AlbedoScales(scale, gray_scale)
        material["albedo_scale"] = scale.tolist()
        for space in ("linear", "srgb"):

            def score(albedo: np.ndarray, factor: np.ndarray, srgb: bool = space == "srgb") -> float:
                triples = zip(albedo, true, covered, strict=True)
                return float(np.mean([albedo_psnr(a, t, c, factor, srgb=srgb) for a, t, c in triples]))

            material[f"albedo_psnr_{space}"] = score(rendered.albedo, scale)
            material[f"albedo_psnr_{space}_unscaled"] = score(rendered.albedo, np.ones(3))
            floor[f"albedo_psnr_{space}"] = score(gray, gray_scale)
        figure, guess = material["albedo_psnr_linear"], floor["albedo_psnr_linear"]
        headline.append(headline_figure("Albedo PSNR (linear)", figure, "dB", guess, "albedo PSNR"))
        scores.albedo = [
            (linear_to_srgb(np.clip(a * scale, 0, 1)) * c[..., None], linear_to_srgb(t) * c[..., None])
            for a, t, c in zip(rendered.albedo, true, covered, strict=True)
        ]
    if truth.roughness is not None:
        true = truth.roughness[list(rows)]
        covered = _coverage(views, cameras, true)
        triples = list(zip(rendered.roughness, true, covered, strict=True))
        material["roughness_mse"] = float(np.mean([roughness_mse(r, t, c) for r, t, c in triples]))
        guesses = [roughness_mse(np.full_like(t, GRAY_ROUGHNESS), t, c) for _, t, c in triples]
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
