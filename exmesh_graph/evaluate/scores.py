"""What all scores share: comparing displayed pictures, which views are taken, entries of a headline, table rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.evaluate.metrics.image import psnr, ssim
from exmesh_graph.gpu.cores import share
from exmesh_graph.io.shots import spread
from exmesh_graph.types import Frame, ScoredViews, Views

Pictures = list[tuple[np.ndarray, np.ndarray]]  # (ours, truth) as displayed


def compare(ours: Sequence[np.ndarray], truth: Sequence[np.ndarray]) -> tuple[list[float], list[float]]:
    """(PSNR [dB], SSIM) of each pair of display images."""
    figures = share(lambda a, b: (psnr(a, b), ssim(a, b)), ours, truth)
    return [db for db, _ in figures], [structure for _, structure in figures]


def pairs_for_pictures(
    pairs: Sequence[tuple[dict[str, Any], np.ndarray, np.ndarray]],
    views: Views,
    chosen: Sequence[int],
    marks: Sequence[np.ndarray],
) -> ScoredViews:
    """(what it is, ours, truth) of display images [H, W, 3] or [H, W] as an artifact.

    `chosen`: the scored views, and `marks` uint8 [H, W] of each (ScoredViews).
    """
    images = np.zeros((len(pairs), 2, views.height, views.width, 3), np.float16)
    for pair, (_, *pictures) in zip(images, pairs, strict=True):
        for place, picture in zip(pair, pictures, strict=True):
            place[:] = picture[..., None] if picture.ndim == 2 else picture
    marked = np.zeros((len(pairs), views.height, views.width), np.uint8)
    for place, (what, _, _) in zip(marked, pairs, strict=True):
        if what["kind"] == "held_out":
            place[:] = marks[what["number"]]
    middle = chosen[len(chosen) // 2]
    return ScoredViews(
        tuple(what for what, _, _ in pairs), images, views.names[middle], views.intrinsics[middle],
        views.camera_to_world[middle], marked,
    )  # fmt: skip


def held_out_pairs(
    values: Mapping[str, Any], held_out: Pictures, names: Sequence[str], count: int
) -> list[tuple[dict[str, Any], np.ndarray, np.ndarray]]:
    """`count` of the held-out pairs, evenly spread, with PSNR and shares; `names` are those of the scored views."""
    psnr_of, shares = values["held_out"]["psnr_per_view"], values["held_out"]["shares_per_view"]

    def what(k: int) -> dict[str, Any]:
        figures = {"psnr": psnr_of[names[k]], **shares[names[k]]}
        return {"kind": "held_out", "name": names[k], "number": k, "figures": figures}

    return [(what(k), *held_out[k]) for k in (spread(len(held_out), count) if count else [])]


def add_lpips(
    values: dict[str, Any],
    weights: Path | None,
    held_out: Pictures,
    relit: Mapping[str, Pictures] | None = None,
    label: str = "Held-out LPIPS",
) -> None:
    """Put `lpips` beside every `psnr` in the figures `values`, by the weights in a file; nothing without one.

    held_out, relit[light]: the (ours, truth) display pictures that the PSNR was taken on. Raises MissingLibraryError
    for a file that holds no such weights.
    """
    if weights is None:
        return
    from exmesh_graph.evaluate.metrics.lpips import Lpips

    lpips = Lpips.from_file(weights)
    each = [lpips(ours, true) for ours, true in held_out]
    views: dict[str, Any] = values["held_out"]
    views["lpips"] = float(np.mean(each))
    views["lpips_per_view"] = dict(zip(views["psnr_per_view"], each, strict=True))
    values["headline"].append(_lower(label, views["lpips"]) | {"series": "held-out LPIPS"})
    if relit:
        lights = values["relit"]["per_light"]
        for light, pairs in relit.items():
            lights[light]["lpips"] = float(np.mean([lpips(ours, true) for ours, true in pairs]))
        values["relit"]["lpips"] = float(np.mean([figures["lpips"] for figures in lights.values()]))
        values["headline"].append(_lower("Relit LPIPS", values["relit"]["lpips"]))


def headline_figure(
    label: str, value: float, unit: str, floor: float | None, series: str, better: str = "higher"
) -> dict[str, Any]:
    """An entry of a headline (docs/report.md)."""
    return {"label": label, "value": value, "unit": unit, "floor": floor, "series": series, "better": better}


def benchmark_row(table: str, scene: str, row: dict[str, float | None], better: dict[str, str]) -> dict[str, Any]:
    """{benchmark, headline}: the row, and its figures as headlines named by their columns."""
    figures = [
        {"label": f"{table} {name}", "value": value, "unit": "", "better": better.get(name, "higher")}
        for name, value in row.items()
        if value is not None
    ]
    return {"benchmark": {"table": table, "scene": scene, "row": row}, "headline": figures}


def exposure_words(exposure: str) -> str:
    """What a label says of figures for which exposures were fitted."""
    return ", exposure fitted" if exposure == "fitted" else ""


def points_to_dataset(points: np.ndarray, frame: Frame) -> np.ndarray:
    """Normalised points in the axes and units of the data set's files, float64 [N, 3]."""
    matrix = frame.dataset_from_scene @ frame.scene_from_normalised
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def _lower(label: str, value: float) -> dict[str, Any]:
    return {"label": label, "value": value, "better": "lower"}
