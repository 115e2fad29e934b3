"""LPIPS of pictures that were scored already: held-out and relit, beside their PSNR and SSIM."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from exmesh_graph.evaluate.metrics.lpips import Lpips
from exmesh_graph.evaluate.scores import Pictures


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


def _lower(label: str, value: float) -> dict[str, Any]:
    return {"label": label, "value": value, "better": "lower"}
