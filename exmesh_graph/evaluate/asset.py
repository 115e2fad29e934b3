"""Scoring a finished asset: held-out views, relit views, materials, each beside its floor.

The floor is what an uninformed guess would score: a uniformly gray object (albedo 0.5, roughness 0.5) of the true
shape, under uniform light of the training images' level for held-out views, and under the true lights for relit ones.
All image figures are of display colours over black, on whole images; where the data has no masks, held-out and relit
views are compared where a `Region` says (evaluate.coverage), and the floor is one gray all over it. Light is cast by
what the held-out pictures allow to be there (evaluate.casting).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exmesh_graph.evaluate.casting import casting_faces, casting_share
from exmesh_graph.evaluate.coverage import (
    compare_flat,
    compare_marked,
    compare_views,
    counted_everywhere,
    region_rows,
    share_figures,
)
from exmesh_graph.evaluate.materials import MaterialScores, score_materials
from exmesh_graph.evaluate.renders import (
    GRAY_ALBEDO,
    Progress,
    Renderer,
    Steps,
    gray_object,
    shown,
    take,
)
from exmesh_graph.evaluate.scores import (
    Pictures,
    compare,
    exposure_words,
    headline_figure,
    held_out_pairs,
    pairs_for_pictures,
)
from exmesh_graph.evaluate.settings import Exposure, Quality, ScaleRule
from exmesh_graph.io.images import display
from exmesh_graph.io.shots import spread
from exmesh_graph.types import Asset, Region, SceneTruth, ScoredViews, Views

#: Pixels of relit pictures held at a time; each takes 36 bytes in ours, ours scaled and the guess.
PIXELS_AT_ONCE = 1 << 24


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
    exposure: Exposure = "fixed",
) -> AssetScores:
    """Score `asset` on held-out `views`, and on `truth`'s relit images and materials where there are any.

    train      the training views, for the level of the floor's uniform light; the scored views stand in without it
    max_views  score this many, evenly spread; 0: all
    rule       how the albedo's scale is found (metrics.material)
    region     what counts in views without masks; DataError where these come without one
    exposure   of the held-out pictures, see `coverage.compare_views`; `psnr_as_exposed` is the PSNR without
    """
    quality = quality or Quality()
    chosen = spread(len(views), max_views)
    if not views.has_masks:
        region_rows(region, views, chosen)
    known = {name: index for index, name in enumerate(truth.names)} if truth is not None else {}
    paired = [(i, known[views.names[i]]) for i in chosen if views.names[i] in known]
    lights = sorted(truth.relit) if truth is not None and paired else []
    guessed = len(chosen) if views.has_masks else 0
    passes = 2 * len(list(_passes(lights, len(paired) * views.height * views.width)))
    steps = Steps(progress, len(chosen) + guessed + passes * len(paired) + bool(quality.bounces))
    casts = casting_faces(asset, views, region)
    ours = Renderer(asset, views, quality, steps, seed, casts, None if views.has_masks else region)
    # The guess scores about 20 dB: neither its silhouette nor its rough highlights need many samples.
    coarse = quality.replaced(supersampling=1, specular_samples=max(1, quality.specular_samples // 2))
    guess = Renderer(gray_object(asset, truth), views, coarse, steps, seed)
    scores = AssetScores({"headline": [], "floor": {}}, chosen)

    (rendered,) = ours.render(chosen)
    if quality.bounces:
        scores.indirect = _indirect(ours, chosen[len(chosen) // 2])
    _score_held_out(scores, rendered, guess, views, chosen, train, region, asset, exposure)
    floor = scores.values["floor"]["held_out_psnr"]
    headline: list[dict[str, Any]] = scores.values["headline"]
    label = "Held-out PSNR" + exposure_words(exposure)
    headline.append(headline_figure(label, scores.values["held_out"]["psnr"], "dB", floor, "held-out PSNR"))
    if not views.has_masks:
        headline += share_figures(scores.values["held_out"])
    scores.values["held_out"]["casting"] = casting_share(asset, casts)
    if casts is not None:
        share = 100 * scores.values["held_out"]["casting"]
        headline.append({"label": "Casts light, share of our surface", "value": share, "unit": "%"})
    if truth is None or not paired:
        return scores
    marks = None if views.has_masks else dict(zip(scores.views, scores.marks, strict=True))
    paired = [(i, k) for i, k in paired if i in scores.views]  # without masks, views of which pixels count
    if not paired:
        return scores
    maps = score_materials(take(rendered, [chosen.index(i) for i, _ in paired]), views, truth, paired, rule, marks)
    headline += maps.headline
    scores.values["floor"] |= maps.floor
    if maps.values:
        scores.values["material"] = maps.values
    scores.albedo, scores.roughness, scores.albedo_maps = maps.albedo, maps.roughness, maps.albedo_maps
    if lights:
        _score_relit(scores, ours, guess, truth, lights, paired, maps, marks)
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
    from exmesh_graph.stage2.scene import Lighting

    whole, direct = ours.render([view], [Lighting(), Lighting(bounces=False)])
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
    exposure: Exposure,
) -> None:
    """Fill `held_out` and its floor."""
    ours = shown(rendered), list(rendered.alpha), asset, views, chosen, region
    compared = compare_views(*ours, exposure)
    if views.has_masks:
        (gray,) = guess.render(chosen)  # light is linear: the level scales the image
        lit = train if train is not None and train.has_masks else views
        level = _uniform_level(lit, gray)
        flat = [display(level * image, alpha) for image, alpha in zip(gray.images, gray.alpha, strict=True)]
        floor = compare_views(flat, list(gray.alpha), asset, views, chosen, exposure=exposure)
    else:
        assert region is not None
        floor, radiance = compare_flat(views, chosen, region, exposure)
        level = radiance / GRAY_ALBEDO
    scores.views, scores.held_out, scores.marks = compared.rows, compared.pairs, compared.marks
    scores.values["held_out"] = compared.figures(views.names)
    if exposure == "fitted":
        scores.values["held_out"]["psnr_as_exposed"] = float(np.mean(compare_views(*ours).psnr))
    scores.values["floor"] |= {
        "held_out_psnr": float(np.mean(floor.psnr)),
        "held_out_ssim": float(np.mean(floor.ssim)),
        "light_level": level,
    }


def _uniform_level(views: Views, gray: Any) -> float:
    """Radiance of the uniform light under which the gray object is as bright as the photographs, on average."""
    under_one = float(gray.images[gray.alpha > 0.5].mean())
    seen = (image[alpha > 0.5] for image, alpha in zip(views.images, views.alpha, strict=True))
    sums = np.array([(values.sum(dtype=np.float64), values.size) for values in seen]).sum(axis=0)
    return float(sums[0] / max(sums[1], 1)) / max(under_one, 1e-6)


def _score_relit(
    scores: AssetScores,
    ours: Renderer,
    guess: Renderer,
    truth: SceneTruth,
    lights: Sequence[str],
    paired: Sequence[tuple[int, int]],
    maps: MaterialScores,
    marks: Mapping[int, np.ndarray] | None,
) -> None:
    """Fill `relit`: per light and mean, with and without the albedo scale, which is never fitted to relit images.

    The gray guess gets a scale of its own by the same rule, so that the margin above it owes nothing to the scale.
    Without masks the pixels are those of the held-out views.
    """
    from exmesh_graph.stage2.scene import Lighting

    cameras, rows = [i for i, _ in paired], [k for _, k in paired]
    per_light: dict[str, dict[str, Any]] = {}
    for some in _passes(lights, len(cameras) * ours.views.height * ours.views.width):
        plain, scaled, gray = ([Lighting(truth.relit[light][0], scale) for light in some]
                               for scale in (None, maps.scale, maps.gray_scale))  # fmt: skip
        rendered = ours.render(cameras, plain if maps.scale is None else plain + scaled)
        floors = guess.render(cameras, gray)
        for number, light in enumerate(some):
            photographs, alpha = truth.relit[light][1], truth.relit_alpha[light]
            true = [display(photographs[k], alpha[k]) for k in rows]
            figures: dict[str, Any] = {}
            taken = {"": rendered[number - len(some)], "_unscaled": rendered[number], "_floor": floors[number]}
            for key, images in ((key, shown(each)) for key, each in taken.items()):
                if marks is None:
                    pairs, (db, structure) = list(zip(images, true, strict=True)), compare(images, true)
                else:
                    here = [marks[i] if key != "_floor" else counted_everywhere(marks[i]) for i in cameras]
                    pairs, db, structure = compare_marked(images, true, here)
                figures |= {f"psnr{key}": float(np.mean(db)), f"ssim{key}": float(np.mean(structure))}
                if not key:
                    names = [truth.names[k] for k in rows]
                    figures["psnr_per_view"] = dict(zip(names, db, strict=True))
                    scores.relit[light] = pairs
            per_light[light] = figures

    def mean(key: str) -> float:
        return float(np.mean([figures[key] for figures in per_light.values()]))

    scores.values["relit"] = {
        "psnr": mean("psnr"),
        "psnr_unscaled": mean("psnr_unscaled"),
        "ssim": mean("ssim"),
        "per_light": per_light,
    }
    scores.values["floor"] |= {"relit_psnr": mean("psnr_floor"), "relit_ssim": mean("ssim_floor")}


def _passes(lights: Sequence[str], pixels: int) -> Iterator[Sequence[str]]:
    """Lights rendered together, rays traced once for all: as many as keep the pictures, `pixels` a light, in memory."""
    together = max(1, PIXELS_AT_ONCE // max(pixels, 1))
    for start in range(0, len(lights), together):
        yield lights[start : start + together]
