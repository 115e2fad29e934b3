"""Material figures by the protocols published for Synthetic4Relight, which are not one protocol.

Photographs fix albedo only up to the brightness of the light, so a factor per channel is taken out first, found on the
test views' true albedo and never on relit pictures; the same factor goes onto the albedo of relit renders. How it is
found differs between programs (`SCALE_RULES`), as do colour space, ground and whether the background counts. The rule
of this project's headline figures is IRGS's mode 2, since it is public, deterministic and one per scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.metrics.image import mse, psnr
from exmesh_graph.evaluate.settings import ScaleRule
from exmesh_graph.io.color import linear_to_srgb

#: Who publishes a rule; ratios are truth / max(estimate, 1e-6), linear, over pixels with alpha > 0.
SCALE_RULES: Mapping[str, str] = MappingProxyType(
    {
        "median": "IRGS mode 2: median of the ratio per channel, over all test pixels",
        "median_red": "IRGS mode 1: median of the red ratio for all three channels",
        "mean": "IRGS mode 3: mean of the ratio per channel",
        "none": "IRGS mode 0, InvRender: no scale",
        "least_squares": "GeoSplatting: least squares per view and channel, averaged over the views",
        "sampled_median": "TensoIR, three channels: median per channel over 20 test views",
        "sampled_red": "TensoIR, one channel: median of the red ratio over 20 test views",
    }
)
#: R3DG's evaluation script has one factor per scene and channel written into it (origin unanswered, R3DG#29).
R3DG_SCALES: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "hotdog": (2.6734, 2.0917, 1.2587),
        "chair": (1.8865, 1.9675, 1.7410),
        "air_baloons": (1.3746, 0.6428, 0.7279),
        "jugs": (1.0044, 0.9253, 0.7648),
    }
)
_SAMPLED = 20


def albedo_scale(albedo: np.ndarray, truth: np.ndarray, alpha: np.ndarray, rule: ScaleRule = "median") -> np.ndarray:
    """Factor per channel, float64 [3], that brings `albedo` to the truth's level by `rule`.

    albedo, truth float [..., 3] linear (all test views of a scene together, [N, H, W, 3] where a rule goes by views),
    alpha [...] the truth's coverage. Raises NumericsError where no pixel is covered or the factor is not finite.
    """
    if rule.startswith("sampled") and albedo.ndim == 4 and len(albedo) > _SAMPLED:
        views = [int((k + 0.5) * len(albedo) / _SAMPLED) for k in range(_SAMPLED)]
        albedo, truth, alpha = albedo[views], truth[views], alpha[views]
    covered = alpha > 0
    if not covered.any():
        raise NumericsError("no test pixel is covered, so the albedo's scale cannot be found")
    if rule == "none":
        return np.ones(3)
    if rule == "least_squares":
        scale = _least_squares(albedo, truth, covered)
    else:
        ratio = truth[covered].astype(np.float64) / np.maximum(albedo[covered].astype(np.float64), 1e-6)
        scale = ratio.mean(axis=0) if rule == "mean" else np.median(ratio, axis=0)
        if rule in ("median_red", "sampled_red"):
            scale = np.repeat(scale[:1], 3)
    if not np.isfinite(scale).all():
        raise NumericsError(f"the albedo's scale is {scale.tolist()}", fix="look for NaN in the estimated albedo")
    return scale


def _least_squares(albedo: np.ndarray, truth: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Mean over the views that show the object of sum(truth albedo) / sum(albedo^2)."""
    views = zip(albedo, truth, covered, strict=True) if albedo.ndim == 4 else [(albedo, truth, covered)]
    scales = []
    for ours, true, inside in views:
        if inside.any():
            a, t = ours[inside].astype(np.float64), true[inside].astype(np.float64)
            scales.append((a * t).sum(0) / np.maximum((a * a).sum(0), 1e-12))
    return np.mean(scales, axis=0)


def albedo_table(
    albedo: np.ndarray, truth: np.ndarray, alpha: np.ndarray, scene: str = ""
) -> dict[str, dict[str, Any]]:
    """Every published albedo figure: rule -> {scale, linear, srgb, linear_masked, srgb_masked}, PSNR in dB, mean over
    the views [N, H, W, 3]; over black. `r3dg` is there for the four scenes of Synthetic4Relight, by name.
    """
    scales = {rule: albedo_scale(albedo, truth, alpha, rule) for rule in SCALE_RULES}  # type: ignore[arg-type]
    if scene in R3DG_SCALES:
        scales["r3dg"] = np.array(R3DG_SCALES[scene])
    views = list(zip(albedo, truth, alpha, strict=True))
    table: dict[str, dict[str, Any]] = {}
    for rule, scale in scales.items():
        row: dict[str, Any] = {"scale": scale.tolist()}
        for srgb in (False, True):
            for masked in (False, True):
                name = ("srgb" if srgb else "linear") + ("_masked" if masked else "")
                shown = [view for view in views if not masked or (view[2] > 0).any()]
                row[name] = float(np.mean([albedo_psnr(a, t, c, scale, srgb=srgb, masked=masked) for a, t, c in shown]))
        table[rule] = row
    return table


def albedo_psnr(
    albedo: np.ndarray,
    truth: np.ndarray,
    alpha: np.ndarray,
    scale: np.ndarray,
    *,
    srgb: bool = False,
    masked: bool = False,
) -> float:
    """PSNR in dB of scale * albedo against truth [H, W, 3], clipped to [0, 1], both times alpha (over black).

    `srgb` encodes both before the comparison; `masked` counts only pixels with alpha > 0. Otherwise, as in the
    published protocol, linear and over the whole image.
    """
    estimate, reference = np.clip(albedo * scale, 0, 1), np.clip(truth, 0, 1)
    if srgb:
        estimate, reference = linear_to_srgb(estimate), linear_to_srgb(reference)
    weight = alpha[..., None]
    return psnr(estimate * weight, reference * weight, alpha > 0 if masked else None)


def roughness_mse(roughness: np.ndarray, truth: np.ndarray, alpha: np.ndarray, *, masked: bool = False) -> float:
    """Mean squared error of roughness [H, W], both times alpha, over the whole image (or where alpha > 0)."""
    return mse(roughness * alpha, truth * alpha, alpha > 0 if masked else None)
