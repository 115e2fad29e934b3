"""LPIPS of pictures that were scored already: held-out and relit, beside their PSNR and SSIM."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from exmesh_graph.metrics.lpips import Lpips
from exmesh_graph.report.scores import Pictures


class Scored(Protocol):
    """Figures, and the (ours, truth) display pictures of the held-out views."""

    values: dict[str, Any]
    held_out: Pictures


def add_lpips(scores: Scored, weights: Path | None, label: str = "Held-out LPIPS") -> None:
    """Put `lpips` beside every `psnr` of held-out and relit pictures, by the weights in a file; nothing without one.

    The pictures are those the PSNR was taken on. Raises MissingLibraryError for a file that holds no such weights.
    """
    if weights is None:
        return
    lpips = Lpips.from_file(weights)
    held_out = scores.values["held_out"]
    each = [lpips(ours, true) for ours, true in scores.held_out]
    held_out["lpips"] = float(np.mean(each))
    held_out["lpips_per_view"] = dict(zip(held_out["psnr_per_view"], each, strict=True))
    headline: list[dict[str, Any]] = scores.values["headline"]
    headline.append(_lower(label, held_out["lpips"]) | {"series": "held-out LPIPS"})
    relit: dict[str, Pictures] = getattr(scores, "relit", {})
    if relit:
        figures = scores.values["relit"]
        for light, pairs in relit.items():
            figures["per_light"][light]["lpips"] = float(np.mean([lpips(ours, true) for ours, true in pairs]))
        figures["lpips"] = float(np.mean([found["lpips"] for found in figures["per_light"].values()]))
        headline.append(_lower("Relit LPIPS", figures["lpips"]))


def _lower(label: str, value: float) -> dict[str, Any]:
    return {"label": label, "value": value, "better": "lower"}
