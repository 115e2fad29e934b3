"""Vignetting: a lens that shows the corners of a picture darker than its middle.

A place is shown at different distances from the middle by different pictures; what it loses towards the corners is the
lens's (Goldman and Chen 2005; Kim and Pollefeys 2008). With the gain g of each picture and s, the square of the
tangent of the angle to the axis over its largest value,

    log(light / other) = g_first - g_second + log V(s_first) - log V(s_second) + h log(cos_first / cos_second)
    log V(s) = -(a s (2 - s) + b s^2 + c s^3)

is solved by least squares with Geman and McClure's weights: highlights and shadows that move are outliers. a, b, c are
not negative: V falls all the way, soon or late. Where what stands in the middle faces the camera there and turns away
at its rim, a lamp beside the camera does what a lens would: h is for that, and where the two cannot be told apart the
error is large.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from exmesh_graph.priors.radiometry.pairs import Pairs

TERMS = 3
_SLOPES = 1  # h
_TURNS = 15
_FOLDS = 6
_FEWEST = 500  # pairs
_LEAST, _SURE = 0.08, 3.0
"""Of log V where it is least: what is worth it (highlights alone have feigned 0.06), and standard errors."""


@dataclass(frozen=True)
class Vignetting:
    """terms  a, b, c;  farthest  the tangent's square where s is 1, beyond which V is as there;  error  standard error
    of log V there;  gains  float64 [N], log of each picture's exposure over the mean."""

    terms: np.ndarray
    farthest: float
    error: float
    gains: np.ndarray

    @property
    def corner(self) -> float:
        """V where it is least."""
        return float(np.exp(-self.terms.sum()))

    @property
    def found(self) -> bool:
        """Whether pictures show some, beyond doubt."""
        return bool(self.terms.sum() > max(_LEAST, _SURE * self.error))

    @property
    def told(self) -> str:
        """For the log."""
        return f"it shows its corners {1 - self.corner:.0%} darker than its middle (+- {self.corner * self.error:.0%})"

    def at(self, squared: np.ndarray) -> np.ndarray:
        """V at squares of tangents."""
        return np.asarray(np.exp(-_powers(squared, self.farthest) @ self.terms))


def vignetting_of(pairs: Pairs, views: int) -> Vignetting:
    """Of the lens that took all `views`; its error from fits each without a sixth of the views."""
    farthest = float(np.quantile(np.concatenate([pairs.squared, pairs.other_squared]), 0.998)) if len(pairs) else 1.0
    if len(pairs) < _FEWEST:
        return Vignetting(np.zeros(TERMS), farthest, np.inf, np.zeros(views))
    terms, gains = _fitted(pairs, views, farthest)
    parts = [_fitted(pairs.of(pairs.first % _FOLDS != fold), views, farthest)[0].sum() for fold in range(_FOLDS)]
    error = float(np.sqrt((_FOLDS - 1) / _FOLDS * np.square(np.array(parts) - np.mean(parts)).sum()))
    return Vignetting(terms, farthest, error, gains)


def _fitted(pairs: Pairs, views: int, farthest: float) -> tuple[np.ndarray, np.ndarray]:
    """(terms, gains)."""
    off = np.log(pairs.light) - np.log(pairs.other)
    columns = _columns(pairs, farthest)
    weight, best = np.ones(len(pairs)), np.zeros(TERMS)
    gains = np.zeros(views)
    for _ in range(_TURNS):
        curvature, slope = _equations(pairs, off, columns, weight, views)
        found = _least(curvature, slope)
        gains, best = found[:views], found[views + _SLOPES :]
        left = off - columns @ found[views:] - gains[pairs.first] + gains[pairs.second]
        scale = 2 * 1.4826 * np.median(np.abs(left)) + 1e-6
        weight = (1 + (left / scale) ** 2) ** -2
    return best, gains - gains.mean()


def _columns(pairs: Pairs, farthest: float) -> np.ndarray:
    """[P, 4], what h, a, b and c are factors of."""
    turned = np.log(pairs.facing) - np.log(pairs.other_facing)
    return np.c_[turned, _powers(pairs.other_squared, farthest) - _powers(pairs.squared, farthest)]


def _equations(
    pairs: Pairs, off: np.ndarray, columns: np.ndarray, weight: np.ndarray, views: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations [N + 4, N + 4], [N + 4] of gains, h and terms."""
    size = views + columns.shape[1]
    curvature, slope = np.zeros((size, size)), np.zeros(size)
    for sign, at in ((1.0, pairs.first), (-1.0, pairs.second)):
        curvature[np.arange(views), np.arange(views)] += np.bincount(at, weight, views)
        slope[:views] += sign * np.bincount(at, weight * off, views)
        for row, column in enumerate(columns.T, views):
            mixed = sign * np.bincount(at, weight * column, views)
            curvature[:views, row] += mixed
            curvature[row, :views] += mixed
    across = np.bincount(pairs.first * views + pairs.second, weight, views * views).reshape(views, views)
    curvature[:views, :views] -= across + across.T
    curvature[views:, views:] = (columns * weight[:, None]).T @ columns
    slope[views:] = columns.T @ (weight * off)
    return curvature, slope


def _least(curvature: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The least squares among all whose last three, the terms, are not negative."""
    size, free = len(slope), len(slope) - TERMS
    floor = np.diag(np.full(size, 1e-6 * np.trace(curvature) / size))  # gains of views that nothing binds
    best, least = np.zeros(size), np.inf
    for count in range(TERMS + 1):
        for chosen in combinations(range(free, size), count):
            rows = np.array([*range(free), *chosen])
            block = curvature[np.ix_(rows, rows)]
            found = np.linalg.solve(block + floor[np.ix_(rows, rows)], slope[rows])
            cost = found @ (block @ found - 2 * slope[rows])
            if (found[free:] >= 0).all() and cost < least:
                least, best = cost, np.zeros(size)
                best[rows] = found
    return best


def _powers(squared: np.ndarray, farthest: float) -> np.ndarray:
    """[..., 3], what a, b and c are factors of."""
    s = np.minimum(squared / farthest, 1.0)
    return np.stack([s * (2 - s), s**2, s**3], axis=-1)
