"""Material figures with the protocol of IRGS's Synthetic4Relight scripts, mode 2.

Photographs fix albedo only up to the brightness of the light, so one factor per channel and scene is taken out first:
the median of truth / estimate over all test pixels with alpha > 0. The same factor goes onto the estimate wherever it
is used afterwards (relit renders); it is never fitted on relit pictures.
"""

from __future__ import annotations

import numpy as np

from exmesh_graph.errors import NumericsError
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.metrics.image import mse, psnr


def albedo_scale(albedo: np.ndarray, truth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Per-channel scale float64 [3]: median of truth / max(albedo, 1e-6) over pixels with alpha > 0.

    albedo, truth float [..., 3] linear (all test views of a scene together), alpha [...] the truth's coverage.
    Raises NumericsError where no pixel is covered or the ratio is not finite.
    """
    covered = alpha > 0
    if not covered.any():
        raise NumericsError("no test pixel is covered, so the albedo's scale cannot be found")
    ratio = truth[covered].astype(np.float64) / np.maximum(albedo[covered].astype(np.float64), 1e-6)
    scale = np.median(ratio, axis=0)
    if not np.isfinite(scale).all():
        raise NumericsError(f"the albedo's scale is {scale.tolist()}", fix="look for NaN in the estimated albedo")
    return scale


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
