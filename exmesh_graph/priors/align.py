"""Relative depth maps (of a network: right up to scale and shift) brought to the world by a few measured depths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exmesh_graph.errors import DataError
from exmesh_graph.types import DepthMaps

_LEAST = 50  # pixels with both depths, below which a view is left out
_ROUNDS = 20


class Alignment(NamedTuple):
    """depths in the world, 0 where unknown; the median error by view; the views that could not be aligned."""

    depths: DepthMaps
    error: dict[str, float]
    left_out: tuple[str, ...]


def align(relative: DepthMaps, measured: DepthMaps, reach: float) -> Alignment:
    """z = s d + t for each view of `measured`, least absolute deviations over the pixels where both are known.

    reach  standard deviation of a Gaussian, in picture widths: what the measured depths differ by from s d + t is
           spread that far and added, and pixels farther from measured ones get no depth. 0: one s and t everywhere.

    A view with fewer than 50 such pixels, or whose best s is not positive, gets no depth and is named. Raises DataError
    for missing maps or other sizes.
    """
    place = {name: i for i, name in enumerate(relative.names)}
    missing = [name for name in measured.names if name not in place]
    if missing:
        raise DataError(
            f"no relative depth for view {missing[0]!r} ({len(missing)} missing)", where="prior.align",
            expected="maps of the same views",
        )  # fmt: skip
    if relative.depth.shape[1:] != measured.depth.shape[1:]:
        raise DataError(
            f"the relative maps are {relative.depth.shape[1:]}, the measured ones {measured.depth.shape[1:]}",
            where="prior.align", expected="maps of one size",
        )  # fmt: skip
    maps, errors, left_out = [], {}, []
    for name, z in zip(measured.names, measured.depth, strict=True):
        d = relative.depth[place[name]].astype(np.float64)
        both = (d > 0) & (z > 0)
        scale, shift = fit_affine(d[both], z[both].astype(np.float64)) if both.sum() >= _LEAST else (0.0, 0.0)
        if not scale > 0:
            left_out.append(name)
            maps.append(np.zeros_like(z))
            continue
        fitted = scale * d + shift
        errors[name] = float(np.median(np.abs(fitted[both] - z[both])))
        known = d > 0
        if reach > 0:
            correction, near = _spread(np.where(both, z - fitted, 0.0), both, reach * z.shape[1])
            fitted, known = fitted + correction, known & near
        maps.append(np.where(known, np.maximum(fitted, 0), 0).astype(np.float32))
    return Alignment(DepthMaps(measured.names, np.stack(maps)), errors, tuple(left_out))


def fit_affine(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """(s, t) with the least sum of |s x + t - y|, by reweighted least squares; (0, median) for constant x."""
    weight = np.ones_like(x)
    scale, shift = 0.0, float(np.median(y))
    tiny = 1e-4 * max(float(np.ptp(y)), 1e-12)
    for _ in range(_ROUNDS):
        total = weight.sum()
        x_mean, y_mean = (weight * x).sum() / total, (weight * y).sum() / total
        variance = (weight * (x - x_mean) ** 2).sum() / total
        if variance <= (1e-6 * max(abs(x_mean), 1e-12)) ** 2:
            return 0.0, float(np.median(y))
        scale = float((weight * (x - x_mean) * (y - y_mean)).sum() / total / variance)
        shift = float(y_mean - scale * x_mean)
        weight = 1 / np.maximum(np.abs(scale * x + shift - y), tiny)
    return scale, shift


def _spread(values: np.ndarray, known: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian mean [H, W] of the known values, and where it has at least a twentieth of the full weight."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(known.astype(np.float64), sigma, mode="constant")
    total = gaussian_filter(np.where(known, values, 0.0), sigma, mode="constant")
    near = weight > 0.05
    return np.where(near, total / np.where(near, weight, 1.0), 0.0), near
