"""What scores can be told: parameters of the nodes `evaluate.*` and `benchmark.*`, declared once. Nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from exmesh_graph.evaluate.metrics.weights import lpips_source
from exmesh_graph.io.settings import Box
from exmesh_graph.params import Params, param

Exposure = Literal["fixed", "fitted"]
ScaleRule = Literal["median", "median_red", "mean", "none", "least_squares", "sampled_median", "sampled_red"]


class Quality(Params):
    """How finely the scored pictures are rendered."""

    directions: int = param(256, ge=32, doc="Directions per surface point of the light transport.")
    bounces: int = param(8, ge=0, le=16, doc="Interreflections in the scored renders.")
    supersampling: int = param(2, ge=1, le=8, unit="samples per pixel side", doc="Antialiasing.")
    specular_samples: int = param(12, ge=1, doc="GGX rays per sample of a pixel.")


class RegionSettings(Params):
    """`evaluate.region`: what counts in held-out views without masks (evaluate.region.find_region)."""

    box: Box | None = param(
        None, doc="Two corners, normalised units: only surface inside counts. Default: the sphere around the object."
    )
    masks: Path | None = param(
        None, doc="Folder of masks for scoring only, named as the held-out views; white counts. Never used by a fit."
    )
    table: Literal["auto", "keep"] = param(
        "auto",
        doc="Auto: a plane that the object stands on, and that goes on beside it, does not count; keep: it does.",
    )
    tolerance: float = param(
        0.1, gt=0, le=1, doc="How far from the photographs' depth surface may lie and cover a pixel; 1: the radius."
    )
    incidence: float = param(80.0, gt=0, le=90, unit="degrees", doc="Depth seen at a more grazing angle is left out.")
    downscale: int = param(2, ge=1, le=16, doc="Look for depth in pictures reduced by this factor.")
    neighbours: int = param(8, ge=2, le=32, unit="views", doc="Training views near each that stereo may compare with.")


class SpeedParams(Quality):
    """`benchmark.speed`."""

    supersampling: int = param(1, ge=1, le=8, unit="samples per pixel side", doc="Antialiasing.")
    specular_samples: int = param(8, ge=1, doc="GGX rays per sample of a pixel.")
    size: int = param(1600, ge=16, le=4096, unit="px", doc="Side of the rendered pictures; the paper's is 1600.")
    frames: int = param(4, ge=2, doc="Frames; the first is a warm-up and not counted.")


class ViewsParams(Params):
    """Which views are scored, and whether by LPIPS."""

    max_views: int = param(0, ge=0, doc="Score this many views, evenly spread; 0: all.")
    lpips: Path | None = param(None, doc="LPIPS's weights, a safetensors file (docs/metrics.md); none: left out.")


class HeldOutParams(ViewsParams):
    """Of scores on photographs whose exposure may wander."""

    exposure: Exposure = param(
        "fixed",
        doc="Fitted: of each held-out photograph one factor per channel is fitted before it is compared, as Stage I "
        "fits those of the training photographs (gains); the report says so, and the figure without stands beside.",
    )


class Stage1Params(HeldOutParams):
    """`evaluate.stage1`."""

    pictures: int = param(2, ge=0, doc="Scored views handed on for pictures (gallery.stage1).")


class AssetParams(HeldOutParams, Quality):
    """`evaluate.asset`."""

    pictures: int = param(3, ge=0, doc="Held-out views handed on for pictures (gallery.asset).")


class OrbParams(ViewsParams, Quality):
    """`benchmark.stanford_orb`."""

    scene: str = param("", doc="The scene's name in the table.")


class Synthetic4RelightParams(OrbParams):
    """`benchmark.synthetic4relight`."""

    rule: ScaleRule = param(
        "median", doc="How the albedo's scale is found, which relit pictures get too (docs/metrics.md)."
    )
    pictures: int = param(3, ge=0, doc="Held-out views handed on for pictures (gallery.asset).")


def lpips_weights(p: ViewsParams) -> Mapping[str, Path]:
    """The file of weights as a node's source. Raises MissingLibraryError as `lpips_source`."""
    return lpips_source(p.lpips)
