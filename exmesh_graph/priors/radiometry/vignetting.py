"""Vignetting: a lens that shows the corners of a picture darker than its middle.

A place is shown at different distances from the middle by different pictures; what it loses towards the corners is the
lens's (Goldman and Chen 2005; Kim and Pollefeys 2008). With the gain g of each picture and s, the square of the
tangent of the angle to the axis over its largest value,

    log(light / other) = g_first - g_second + log V(s_first) - log V(s_second)
    log V(s) = -(a s (2 - s) + b s^2 + c s^3)

is solved by least squares with Geman and McClure's weights: highlights and shadows that move are outliers. a, b, c are
not negative: V falls all the way, soon or late.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from exmesh_graph.priors.radiometry.pairs import Pairs

TERMS = 3
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
    powers = _powers(pairs.other_squared, farthest) - _powers(pairs.squared, farthest)
    weight, best = np.ones(len(pairs)), np.zeros(TERMS)
    gains = np.zeros(views)
    for _ in range(_TURNS):
        curvature, slope = _equations(pairs, off, powers, weight, views)
        best, gains = _least(curvature, slope, views)
        left = off - powers @ best - gains[pairs.first] + gains[pairs.second]
        scale = 2 * 1.4826 * np.median(np.abs(left)) + 1e-6
        weight = (1 + (left / scale) ** 2) ** -2
    return best, gains - gains.mean()


def _equations(
    pairs: Pairs, off: np.ndarray, powers: np.ndarray, weight: np.ndarray, views: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations [N + 3, N + 3], [N + 3] of gains and terms."""
    size = views + TERMS
    curvature, slope = np.zeros((size, size)), np.zeros(size)
    for sign, at in ((1.0, pairs.first), (-1.0, pairs.second)):
        curvature[np.arange(views), np.arange(views)] += np.bincount(at, weight, views)
        slope[:views] += sign * np.bincount(at, weight * off, views)
        for term in range(TERMS):
            mixed = sign * np.bincount(at, weight * powers[:, term], views)
            curvature[:views, views + term] += mixed
            curvature[views + term, :views] += mixed
    across = np.bincount(pairs.first * views + pairs.second, weight, views * views).reshape(views, views)
    curvature[:views, :views] -= across + across.T
    curvature[views:, views:] = (powers * weight[:, None]).T @ powers
    slope[views:] = powers.T @ (weight * off)
    return curvature, slope


def _least(curvature: np.ndarray, slope: np.ndarray, views: int) -> tuple[np.ndarray, np.ndarray]:
    """(terms, gains) of the least squares among all with terms that are not negative."""
    kept = np.arange(views)
    floor = 1e-6 * np.trace(curvature[:views, :views]) / views  # gains of views that nothing binds
    best = np.inf, np.zeros(TERMS), np.zeros(views)
    for count in range(TERMS + 1):
        for chosen in combinations(range(TERMS), count):
            rows = np.concatenate([kept, views + np.array(chosen, int)])
            block = curvature[np.ix_(rows, rows)] + floor * np.diag((np.arange(len(rows)) < views).astype(float))
            found = np.linalg.solve(block + 1e-12 * np.eye(len(rows)), slope[rows])
            cost = found @ (curvature[np.ix_(rows, rows)] @ found - 2 * slope[rows])
            if (found[views:] >= 0).all() and cost < best[0]:
                terms = np.zeros(TERMS)
                terms[list(chosen)] = found[views:]
                best = cost, terms, found[:views]
    return best[1], best[2]


def _powers(squared: np.ndarray, farthest: float) -> np.ndarray:
    """[..., 3], what a, b and c are factors of."""
    s = np.minimum(squared / farthest, 1.0)
    return np.stack([s * (2 - s), s**2, s**3], axis=-1)
