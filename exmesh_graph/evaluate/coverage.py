"""Comparing rendered views with photographs on pixels that the data chooses, never the surface that is scored.

With masks: the whole picture over black, where what is missing is black and what lies outside the mask shows.

Without masks: the pixels of a `Region`. One is covered where the nearest surface lies at its depths, and where what
drew the picture says so too (`renders.Renderer`: where all its samples do). One that is not costs what black costs in
this region on average, and none costs more: so no pixel gets better by losing its surface, and none by a sheet that
stands elsewhere. Surface outside the region is counted and shown, and changes no figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from exmesh_graph.errors import DataError
from exmesh_graph.evaluate.metrics.image import psnr, ssim, ssim_map
from exmesh_graph.evaluate.scores import Pictures
from exmesh_graph.evaluate.settings import Exposure
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.io.images import display
from exmesh_graph.raster import rasterize
from exmesh_graph.types import Mesh, Region, ScoredViews, Views

FITTED = "one factor per photograph and channel, fitted to it"
_DIMMED = 0.25  # the photograph outside the region, the same in both pictures of a pair


@dataclass(frozen=True)
class Compared:
    """What was compared, view by view, and what came out.

    rows   indices into the views of those that could be scored: all but those whose region is empty
    pairs  (ours, truth) as compared, display values;  marks  uint8 [H, W], as in ScoredViews
    psnr [dB], ssim: of each;  region, covered, leaked: shares of each, see `shares`
    exposures  factors [3] of each that ours was multiplied by, where they were fitted
    """

    rows: list[int]
    pairs: Pictures
    marks: list[np.ndarray]
    psnr: list[float]
    ssim: list[float]
    region: list[float]
    covered: list[float]
    leaked: list[float]
    source: str
    exposures: list[list[float]] | None = None

    def figures(self, names: Sequence[str]) -> dict[str, Any]:
        """`held_out` of a score: means over the views, each view's, and the shares."""
        own = [names[row] for row in self.rows]
        return {
            "psnr": float(np.mean(self.psnr)),
            "ssim": float(np.mean(self.ssim)),
            "psnr_per_view": dict(zip(own, self.psnr, strict=True)),
            "ssim_per_view": dict(zip(own, self.ssim, strict=True)),
            "region": self.source,
            "shares": self.shares(),
            "exposure": "as it is" if self.exposures is None else FITTED,
            "shares_per_view": {
                name: {"region": a, "covered": b, "leaked": c}
                for name, a, b, c in zip(own, self.region, self.covered, self.leaked, strict=True)
            },
            "views": len(own),
            **({} if self.exposures is None else {"exposures_per_view": dict(zip(own, self.exposures, strict=True))}),
        }

    def shares(self) -> dict[str, float]:
        """region: of the picture; covered: of the region; leaked: of our surface, what shows outside the region."""
        return {name: float(np.mean(getattr(self, name))) for name in ("region", "covered", "leaked")}


def compare_views(
    ours: Sequence[np.ndarray],
    alpha: Sequence[np.ndarray],
    surface: Mesh,
    views: Views,
    chosen: Sequence[int],
    region: Region | None = None,
    exposure: Exposure = "fixed",
) -> Compared:
    """Compare pictures of `surface`, display values over black [H, W, 3] with coverage [H, W], with the chosen views.

    Without masks `region` says what counts, and what has no coverage is missing. `exposure` fitted: each picture is
    first multiplied by the factor of each channel that is best over what counts and is covered, for photographs whose
    exposure wanders. Raises DataError where the region is missing, belongs to other views, or is empty in all of them.
    """
    if views.has_masks:
        parts = [(views.alpha[i] > 0.5) & (part > 0.5) for i, part in zip(chosen, alpha, strict=True)]
        ours, factors = exposed(ours, parts, views, chosen, exposure)
        return replace(_whole(ours, alpha, views, chosen), exposures=factors)
    rows = region_rows(region, views, chosen)
    assert region is not None
    depths = surface_depths(surface, views.subset(chosen))
    parts = [region.inside[row] & (depth >= region.near[row]) & (depth <= region.far[row]) & (part > 0)
             for row, depth, part in zip(rows, depths, alpha, strict=True)]  # fmt: skip
    ours, factors = exposed(ours, parts, views, chosen, exposure)
    compared = _within(ours, parts, depths, views, chosen, region)
    if factors is not None:
        factors = [factors[list(chosen).index(row)] for row in compared.rows]
    return replace(compared, exposures=factors)


def exposed(
    ours: Sequence[np.ndarray], parts: Sequence[np.ndarray], views: Views, chosen: Sequence[int], exposure: Exposure
) -> tuple[Sequence[np.ndarray], list[list[float]] | None]:
    """(pictures, factors [3] of each): under the exposure that brings them to the photographs, where it is fitted.

    Factors of display values, of least squares over `parts` (bool [H, W], where ours and the photograph show the same),
    within two stops of display values; 1 where there is too little to tell.
    """
    if exposure == "fixed":
        return ours, None
    pictures, factors = [], []
    for picture, part, i in zip(ours, parts, chosen, strict=True):
        own, true = picture[part].astype(np.float64), display(views.images[i], views.alpha[i])[part]
        power = np.square(own).sum(axis=0)
        factor = np.where(power > 1e-6, (own * true).sum(axis=0) / np.maximum(power, 1e-12), 1.0).clip(0.5, 2)
        pictures.append(np.clip(picture * factor, 0, 1).astype(picture.dtype))
        factors.append([round(float(one), 4) for one in factor])
    return pictures, factors


def compare_flat(
    views: Views, chosen: Sequence[int], region: Region, exposure: Exposure = "fixed"
) -> tuple[Compared, float]:
    """The guess of one gray all over the region, and its level: the photographs' mean linear radiance there."""
    rows = region_rows(region, views, chosen)
    inside = region.inside[rows]
    level = float(views.images[list(chosen)][inside].mean())
    gray = display(np.full((views.height, views.width, 3), level, np.float32), np.ones((views.height, views.width)))
    flat, _ = exposed([gray.astype(np.float32)] * len(rows), list(inside), views, chosen, exposure)
    return _within(flat, list(inside), np.zeros(inside.shape, np.float32), views, chosen, region), level


def compare_marked(
    ours: Sequence[np.ndarray], photographs: Sequence[np.ndarray], marks: Sequence[np.ndarray]
) -> tuple[Pictures, list[float], list[float]]:
    """(ours, truth) as compared, PSNR [dB] and SSIM of pairs of display values [H, W, 3], over what `marks` let count.

    marks  uint8 [H, W] of each as in ScoredViews: COUNTED pixels are compared, MISSING ones are wrong, no other counts
    """
    pairs, db, structure = [], [], []
    for picture, photograph, mark in zip(ours, photographs, marks, strict=True):
        inside, covered = counted(mark)
        truth = np.where(inside[..., None], photograph, _DIMMED * photograph)
        own = np.where(inside[..., None], np.where(covered[..., None], picture, 0), truth)
        pairs.append((own, truth))
        db.append(truncated_psnr(own, truth, inside, covered))
        # black may fit a dark photograph better than what stood there: windows around see the colour that fits least
        worst = np.where((inside & ~covered)[..., None], (truth < 0.5).astype(own.dtype), own)
        similar = np.where(covered, np.maximum(ssim_map(worst, truth).mean(axis=-1), 0), 0)
        structure.append(float(similar[inside].mean()))
    return pairs, db, structure


def truncated_psnr(ours: np.ndarray, truth: np.ndarray, inside: np.ndarray, covered: np.ndarray) -> float:
    """PSNR over `inside`, where a pixel that is not covered costs the mean of truth^2 there, and no pixel more."""
    black = float(np.square(truth[inside].astype(np.float64)).mean())
    squared = np.square(ours.astype(np.float64) - truth).mean(axis=-1)
    error = float(np.where(covered, np.minimum(squared, black), black)[inside].mean())
    return min(100.0, float(-10 * np.log10(error))) if error > 0 else 100.0


def counted(mark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(what counts, what of it our surface covers), bool [H, W], of a mark as in ScoredViews."""
    covered = mark == ScoredViews.COUNTED
    return covered | (mark == ScoredViews.MISSING), covered


def counted_everywhere(mark: np.ndarray) -> np.ndarray:
    """`mark` as of a surface that covers the whole region."""
    return np.where(mark == ScoredViews.MISSING, ScoredViews.COUNTED, mark).astype(np.uint8)


def region_rows(region: Region | None, views: Views, chosen: Sequence[int]) -> list[int]:
    """Rows of the region that belong to the chosen views."""
    where = "evaluate"
    if region is None:
        raise DataError("the held-out views have no masks, so nothing says which pixels count", where=where,
                        expected="a region found in the data",
                        fix='add a node {type: evaluate.region, views: "@views.test", train: "@views.train"} and wire '
                        "its output `region` here")  # fmt: skip
    known = {name: row for row, name in enumerate(region.names)}
    names = [views.names[i] for i in chosen]
    missing = [name for name in names if name not in known]
    if missing or region.inside.shape[1:] != views.alpha.shape[1:]:
        what = (
            f"misses view {missing[0]}"
            if missing
            else f"has {region.inside.shape[2]} x {region.inside.shape[1]} pixels"
        )
        raise DataError(f"the region {what}", where=where, expected=f"the scored views, {views.width} x {views.height}",
                        fix="wire the same views to evaluate.region")  # fmt: skip
    rows = [known[name] for name in names]
    if not region.inside[rows].any():
        raise DataError("the region is empty in every held-out view: their depth was not found", where=where,
                        fix="wire the training views to `train` of evaluate.region, or give it `masks`")  # fmt: skip
    return rows


def surface_depths(surface: Mesh, views: Views) -> np.ndarray:
    """Depth float32 [N, H, W] of the nearest surface at pixel centres, 0 where there is none."""
    vertices, faces = (
        tensor_of(np.asarray(surface.vertices, np.float32)),
        tensor_of(np.asarray(surface.faces, np.int32)),
    )
    depths = [
        rasterize(vertices, faces, torch.from_numpy(k), torch.from_numpy(pose), views.height, views.width).depth.numpy()
        for k, pose in zip(np.asarray(views.intrinsics, np.float64), views.world_to_camera, strict=True)
    ]
    return np.stack(depths)


def share_figures(held_out: Mapping[str, Any], suffix: str = "") -> list[dict[str, Any]]:
    """Entries of a headline for the three shares, in per cent; only where the region is not the mask's."""
    shares = held_out["shares"]
    words = (
        ("Region, share of the pictures", "region", ""),
        ("Covered, share of the region", "covered", "higher"),
        ("Leaked, share of our surface", "leaked", ""),
    )
    return [
        {"label": label + suffix, "value": 100 * shares[key], "unit": "%"} | ({"better": better} if better else {})
        for label, key, better in words
    ]


def _whole(ours: Sequence[np.ndarray], alpha: Sequence[np.ndarray], views: Views, chosen: Sequence[int]) -> Compared:
    """Whole pictures over black, as published."""
    true = [display(views.images[i], views.alpha[i]) for i in chosen]
    pairs = list(zip(ours, true, strict=True))
    inside = [views.alpha[i] > 0.5 for i in chosen]
    shown = [part > 0.5 for part in alpha]
    covered = [a & b for a, b in zip(inside, shown, strict=True)]
    return Compared(
        list(chosen), pairs, [_marks(*parts) for parts in zip(inside, covered, shown, strict=True)],
        [psnr(a, b) for a, b in pairs], [ssim(a, b) for a, b in pairs],
        *_shares(inside, covered, shown), "whole image, over black",
    )  # fmt: skip


def _within(
    ours: Sequence[np.ndarray],
    covered: Sequence[np.ndarray],
    depths: np.ndarray,
    views: Views,
    chosen: Sequence[int],
    region: Region,
) -> Compared:
    """The pixels of the region alone; `covered` bool [H, W] of each view lies in it."""
    rows = region_rows(region, views, chosen)
    kept = [n for n, row in enumerate(rows) if region.inside[row].any()]
    shown = [depths[n] > 0 for n in kept]
    insides, here = [region.inside[rows[n]] for n in kept], [covered[n] for n in kept]
    marks = [_marks(*parts) for parts in zip(insides, here, shown, strict=True)]
    photographs = [display(views.images[i], views.alpha[i]) for i in (chosen[n] for n in kept)]
    pairs, db, structure = compare_marked([ours[n] for n in kept], photographs, marks)
    source = {
        "depth": "where the photographs' own depth lies in the object's box",
        "hull": "what shows the hull of the training masks",
        "masks": "masks for scoring",
    }
    return Compared([chosen[n] for n in kept], pairs, marks, db, structure, *_shares(insides, here, shown),
                    source[region.source])  # fmt: skip


def _marks(inside: np.ndarray, covered: np.ndarray, shown: np.ndarray) -> np.ndarray:
    marks = np.where(covered, ScoredViews.COUNTED, np.where(inside, ScoredViews.MISSING, 0))
    return np.where(shown & ~inside, ScoredViews.LEAKED, marks).astype(np.uint8)


def _shares(
    inside: Sequence[np.ndarray], covered: Sequence[np.ndarray], shown: Sequence[np.ndarray]
) -> tuple[list[float], list[float], list[float]]:
    region = [float(a.mean()) for a in inside]
    cover = [float(b.sum() / max(a.sum(), 1)) for a, b in zip(inside, covered, strict=True)]
    leak = [float((s & ~a).sum() / max(s.sum(), 1)) for a, s in zip(inside, shown, strict=True)]
    return region, cover, leak
