"""Image figures on display colour over black: PSNR and SSIM, over the whole image or the object's pixels."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from exmesh_graph.errors import NumericsError
from exmesh_graph.io.images import display

__all__ = ["display", "mse", "psnr", "ssim", "ssim_map"]

_SIGMA, _RADIUS = 1.5, 5


def mse(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean squared difference over all values, or over the pixels where `mask` [...] (bool) holds.

    NaN for a mask without pixels is never returned: NumericsError is raised, as for values that are not finite.
    """
    if image.shape != reference.shape:
        raise NumericsError(f"cannot compare images of shapes {image.shape} and {reference.shape}")
    squared = (image.astype(np.float64) - reference.astype(np.float64)) ** 2
    if mask is not None:
        squared = squared[np.asarray(mask, bool)]
    if squared.size == 0:
        raise NumericsError("no pixel to compare: the mask is empty")
    value = float(squared.mean())
    if not np.isfinite(value):
        raise NumericsError("an image holds NaN or Inf", fix="look at the step that rendered it")
    return value


def psnr(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB, 10 log10(peak^2 / mse); 100 for equal images, so that means stay finite."""
    error = mse(image, reference, mask)
    return min(100.0, float(10 * np.log10(peak**2 / error))) if error > 0 else 100.0


def ssim(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Structural similarity (Wang et al. 2004) of [H, W, C] or [H, W] in [0, 1], mean over pixels and channels.

    Gaussian window of 11 x 11, sigma 1.5, population variances, C1 = 0.01^2, C2 = 0.03^2; the outer 5 pixels, where
    the window leaves the image, are left out. With `mask` [H, W] the mean is over its pixels only.
    """
    values = ssim_map(image, reference)
    inner = values[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
    if mask is not None:
        inner = inner[np.asarray(mask, bool)[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS]]
    if inner.size == 0:
        raise NumericsError("no pixel to compare: the image is smaller than the window, or the mask is empty")
    return float(inner.mean())


def ssim_map(image: np.ndarray, reference: np.ndarray, *, radius: int = _RADIUS, mode: str = "reflect") -> np.ndarray:
    """SSIM at every pixel, same shape as the inputs; near the border it is extrapolated by reflection.

    `radius` is the window's (5: 11 x 11), `mode` scipy's name for what lies beyond the border. Where no pixel of a
    window differs it is 1, and not computed: around an object over black that is most of a picture.
    """
    if image.shape != reference.shape:
        raise NumericsError(f"cannot compare images of shapes {image.shape} and {reference.shape}")
    differs = image != reference
    rows, columns = np.nonzero(differs if differs.ndim == 2 else differs.any(axis=2))
    whole = np.ones(image.shape)
    if len(rows) == 0:
        return whole
    box = [(int(index.min()), int(index.max()) + 1) for index in (rows, columns)]
    asked, shown = (
        tuple(slice(max(low - reach, 0), high + reach) for low, high in box) for reach in (2 * radius, radius)
    )
    inner = tuple(slice(of.start - by.start, of.stop - by.start) for of, by in zip(shown, asked, strict=True))
    whole[shown] = _similarity(image[asked], reference[asked], radius, mode)[inner]
    return whole


def _similarity(image: np.ndarray, reference: np.ndarray, radius: int, mode: str) -> np.ndarray:
    x, y = image.astype(np.float64), reference.astype(np.float64)

    def blur(values: np.ndarray) -> np.ndarray:
        sigma = (_SIGMA, _SIGMA) + (0,) * (values.ndim - 2)
        return gaussian_filter(values, sigma, truncate=radius / _SIGMA, mode=mode)

    mean_x, mean_y = blur(x), blur(y)
    # Differences of nearly equal numbers: a variance may come out as -1e-17.
    var_x = np.maximum(blur(x * x) - mean_x**2, 0)
    var_y = np.maximum(blur(y * y) - mean_y**2, 0)
    cov = blur(x * y) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    return ((2 * mean_x * mean_y + c1) * (2 * cov + c2)) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))
