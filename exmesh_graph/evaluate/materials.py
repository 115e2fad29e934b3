"""Scoring the maps of a finished asset, base colour and roughness, as the test views show them.

With masks: whole pictures over black, as published, where surface beside the mask is wrong. Without: the pixels that
count in the held-out view, where what is missing is wrong and no pixel costs more (evaluate.coverage).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exmesh_graph.evaluate.coverage import counted, truncated_psnr
from exmesh_graph.evaluate.metrics.material import albedo_psnr, albedo_scale, roughness_mse
from exmesh_graph.evaluate.renders import GRAY_ALBEDO, GRAY_ROUGHNESS
from exmesh_graph.evaluate.scores import Pictures, headline_figure
from exmesh_graph.evaluate.settings import ScaleRule
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.types import SceneTruth, Views


@dataclass
class MaterialScores:
    """What was found; everything is empty where the truth has no such map, or none of its pixels count.

    values, floor  figures by name;  headline  entries of a headline
    scale, gray_scale  factors [3] onto albedo, of our asset and of the gray guess; None where no true albedo is known
    albedo, roughness  (ours, truth) per view, albedo scaled and sRGB-encoded
    albedo_maps  (ours, truth, coverage) [M, H, W, 3], linear, unscaled
    """

    values: dict[str, Any] = field(default_factory=dict)
    floor: dict[str, Any] = field(default_factory=dict)
    headline: list[dict[str, Any]] = field(default_factory=list)
    scale: np.ndarray | None = None
    gray_scale: np.ndarray | None = None
    albedo: Pictures = field(default_factory=list)
    roughness: Pictures = field(default_factory=list)
    albedo_maps: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None


def score_materials(
    rendered: Any,
    views: Views,
    truth: SceneTruth,
    paired: Sequence[tuple[int, int]],
    rule: ScaleRule,
    marks: Mapping[int, np.ndarray] | None = None,
) -> MaterialScores:
    """Score the maps in `rendered` (stage2.render.Rendered) of the views paired (row of `views`, row of `truth`).

    rule   how the albedo's scale is found (metrics.material)
    marks  uint8 [H, W] as in ScoredViews, of each row of views without masks; None with masks
    """
    scores = MaterialScores()
    if truth.albedo is not None:
        _score_albedo(scores, rendered, _Pixels.of(truth.albedo, rendered.alpha, views, paired, marks), rule)
    if truth.roughness is not None:
        _score_roughness(scores, rendered, _Pixels.of(truth.roughness, rendered.alpha, views, paired, marks))
    return scores


@dataclass(frozen=True)
class _Pixels:
    """true [M, H, W(, 3)], 0 where unknown; inside float32 [M, H, W], the truth's coverage where it counts; shown bool
    [M, H, W], where ours counts; missing bool [M, H, W], what of the truth has nothing of ours; weight [M, H, W], what
    both are weighed by with masks, None without.
    """

    true: np.ndarray
    inside: np.ndarray
    shown: np.ndarray
    missing: np.ndarray
    weight: np.ndarray | None

    @classmethod
    def of(
        cls,
        maps: np.ndarray,
        alpha: np.ndarray,
        views: Views,
        paired: Sequence[tuple[int, int]],
        marks: Mapping[int, np.ndarray] | None,
    ) -> _Pixels:
        true = maps[[k for _, k in paired]]
        if marks is None:
            inside = views.alpha[[i for i, _ in paired]]
            # outside the mask both are weighed by our own coverage, and the truth is 0
            shown, weight = np.ones(inside.shape, bool), np.where(inside > 0, inside, alpha)
        else:
            filled = true > 0 if true.ndim == 3 else (true > 0).any(axis=-1)
            places = [counted(marks[i]) for i, _ in paired]
            inside = (filled & np.stack([within for within, _ in places])).astype(np.float32)
            shown, weight = np.stack([covered for _, covered in places]), None
        kept, missing = inside > 0, ((alpha == 0) | ~shown) & (inside > 0.5)
        known = np.where(kept[..., None] if true.ndim == 4 else kept, true, 0).astype(true.dtype)
        return cls(known, inside, shown, missing, weight)

    @property
    def rows(self) -> list[int]:
        """Views of which pixels count."""
        return [n for n, inside in enumerate(self.inside) if self.weight is not None or inside.any()]


def _score_albedo(scores: MaterialScores, rendered: Any, pixels: _Pixels, rule: ScaleRule) -> None:
    if not pixels.rows:
        return
    true, inside = pixels.true, pixels.inside
    ours = np.where(pixels.shown[..., None], rendered.albedo, 0).astype(np.float32)
    gray = np.full_like(true, GRAY_ALBEDO)
    # what is missing would be infinitely too dark, and move the scale of all the rest
    there = np.where(pixels.missing, 0, inside)
    scale = albedo_scale(ours, true, there if there.any() else inside, rule)
    gray_scale = albedo_scale(gray, true, inside, rule)
    scores.scale, scores.gray_scale, scores.albedo_maps = scale, gray_scale, (ours, true, inside)
    scores.values["albedo_scale"] = scale.tolist()
    for space in ("linear", "srgb"):
        figure = _albedo_figure(pixels, srgb=space == "srgb")
        scores.values[f"albedo_psnr_{space}"] = figure(ours, scale, False)
        scores.values[f"albedo_psnr_{space}_unscaled"] = figure(ours, np.ones(3), False)
        scores.floor[f"albedo_psnr_{space}"] = figure(gray, gray_scale, True)
    value, guess = scores.values["albedo_psnr_linear"], scores.floor["albedo_psnr_linear"]
    scores.headline.append(headline_figure("Albedo PSNR (linear)", value, "dB", guess, "albedo PSNR"))
    scores.albedo = [
        (linear_to_srgb(np.clip(a * scale, 0, 1)) * c[..., None], linear_to_srgb(t) * c[..., None])
        for a, t, c in zip(ours, true, inside, strict=True)
    ]


def _albedo_figure(pixels: _Pixels, srgb: bool) -> Callable[[np.ndarray, np.ndarray, bool], float]:
    """(albedo [M, H, W, 3], factor [3], whether it covers just what the truth covers) -> PSNR [dB]."""

    def figure(albedo: np.ndarray, factor: np.ndarray, exact: bool) -> float:
        if pixels.weight is not None:
            weight = pixels.inside if exact else pixels.weight
            shown = np.clip(albedo * factor, 0, 1)
            if not exact:  # black may be nearer to a dark truth than what stood there
                shown = np.where(pixels.missing[..., None], pixels.true < 0.5, shown)
            triples = zip(shown, pixels.true, weight, strict=True)
            return float(np.mean([albedo_psnr(a, t, c, np.ones(3), srgb=srgb) for a, t, c in triples]))
        db = []
        for n in pixels.rows:
            inside = pixels.inside[n] > 0
            pair = np.clip(albedo[n] * factor, 0, 1), np.clip(pixels.true[n], 0, 1)
            ours, true = (linear_to_srgb(one) if srgb else one for one in pair)
            db.append(truncated_psnr(ours, true, inside, inside if exact else pixels.shown[n]))
        return float(np.mean(db))

    return figure


def _score_roughness(scores: MaterialScores, rendered: Any, pixels: _Pixels) -> None:
    if not pixels.rows:
        return
    # 0 is no wrong roughness where a surface is glossy: what is missing is as wrong as can be
    ours = np.where(pixels.missing, pixels.true < 0.5, rendered.roughness).astype(np.float32)
    weight, masked = pixels.inside if pixels.weight is None else pixels.weight, pixels.weight is None
    mean, guess = (
        float(np.mean([roughness_mse(own[n], pixels.true[n], by[n], masked=masked) for n in pixels.rows]))
        for own, by in ((ours, weight), (np.full_like(pixels.true, GRAY_ROUGHNESS), pixels.inside))
    )
    scores.values["roughness_mse"], scores.floor["roughness_mse"] = mean, guess
    scores.headline.append(headline_figure("Roughness MSE", mean, "", guess, "roughness MSE", "lower"))
    scores.roughness = [(r * c, t * c) for r, t, c in zip(ours, pixels.true, weight, strict=True)]
