"""Matches between neighbouring pictures: corners (Shi and Tomasi 1994), BRIEF (Calonder et al. 2010), then sub-pixel.

Nothing here asks the cameras: pairs of pictures that look alike are matched, so that wrong cameras can be told by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from exmesh_graph.io.still import STILL

_CORNERS = 500
_THUMB = 24
_HALF = 5  # of the patch that is aligned
_TURNS = 4
_TINT = 0.05
_FEWEST = 12


@dataclass(frozen=True)
class Pair:
    """Matched places in two pictures: float64 [M, 2] each, x and y in pixels, centres at +0.5."""

    first: int
    second: int
    places: np.ndarray
    others: np.ndarray


def match_pairs(pictures: np.ndarray, chosen: Sequence[tuple[int, int]]) -> list[Pair]:
    """Match pairs of pictures float [N, H, W, 3] (display values), without those with fewer than a dozen matches."""
    gray = {view: pictures[view].mean(axis=-1, dtype=np.float64) for pair in chosen for view in pair}
    features = {view: _features(picture) for view, picture in sorted(gray.items())}
    found = []
    for first, second in chosen:
        places, others = _matched(features[first], features[second])
        places, others = _alike_in_tint(pictures[first], pictures[second], places, others)
        if len(places) >= _FEWEST:
            places, others = _aligned(gray[first], gray[second], places, others)
        if len(places) >= _FEWEST:
            found.append(Pair(first, second, places + 0.5, others + 0.5))
    return that_move(found, max(pictures[0].shape)) if found else found


def that_move(pairs: list[Pair], side: int) -> list[Pair]:
    """Without matches at rest where most are: behind a turntable (`io.still`), of whose cameras they do not tell."""
    moving = [np.linalg.norm(pair.places - pair.others, axis=1) > STILL * side for pair in pairs]
    if np.median([moved.mean() for moved in moving]) > 0.5:
        return pairs
    return [
        Pair(pair.first, pair.second, pair.places[moved], pair.others[moved])
        for pair, moved in zip(pairs, moving, strict=True)
        if moved.sum() >= _FEWEST
    ]


def alike(pictures: np.ndarray, neighbours: int = 1) -> list[tuple[int, int]]:
    """For each of [N, H, W, 3], it and those most like it (correlation of small, smoothed copies); each pair once."""
    small = np.stack([_thumbnail(picture) for picture in pictures])
    small -= small.mean(axis=1, keepdims=True)
    small /= np.maximum(np.linalg.norm(small, axis=1, keepdims=True), 1e-9)
    return nearest_pairs(small @ small.T, neighbours)


def nearest_pairs(likeness: np.ndarray, neighbours: int = 1) -> list[tuple[int, int]]:
    """Each row of [N, N] with its largest entries off the diagonal; each pair once."""
    likeness = likeness.copy()
    np.fill_diagonal(likeness, -np.inf)
    best = np.argsort(-likeness, axis=1, kind="stable")[:, : min(neighbours, len(likeness) - 1)]
    return sorted({(min(i, int(j)), max(i, int(j))) for i, row in enumerate(best) for j in row})


def _thumbnail(picture: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    block = max(1, max(height, width) // _THUMB)
    rows, columns = height // block, width // block
    cut = picture[: rows * block, : columns * block].reshape(rows, block, columns, block, 3)
    return np.asarray(gaussian_filter(cut.mean(axis=(1, 3), dtype=np.float64), (0.7, 0.7, 0)).ravel())


def _alike_in_tint(
    picture: np.ndarray, other: np.ndarray, places: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Without matches of unlike colour: gray patches of a red and a green wall may be equal."""
    tints = []
    for image, at in ((picture, places), (other, others)):
        colour = np.asarray(image[at[:, 1].astype(int), at[:, 0].astype(int)], np.float64) + 0.02
        tints.append(colour / colour.sum(axis=1, keepdims=True))
    kept = np.abs(tints[0] - tints[1]).max(axis=1, initial=0) < _TINT
    return places[kept], others[kept]


def _features(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(corners int [C, 2] as row and column, descriptors bool [C, 256])."""
    from skimage.feature import BRIEF, corner_peaks, corner_shi_tomasi

    response = corner_shi_tomasi(picture, sigma=1.5)
    corners = corner_peaks(response, min_distance=3, threshold_rel=0.002, num_peaks=_CORNERS)
    if len(corners) < _FEWEST:
        return np.zeros((0, 2), int), np.zeros((0, 256), bool)
    brief = BRIEF(descriptor_size=256, patch_size=31, sigma=1.5, rng=0)
    brief.extract(picture, corners)
    return corners[brief.mask], np.asarray(brief.descriptors)


def _matched(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of both pictures float64 [M, 2] (x, y) whose descriptors are each other's nearest, and clearly so."""
    from skimage.feature import match_descriptors

    if min(len(one[0]), len(other[0])) < _FEWEST:
        return np.zeros((0, 2)), np.zeros((0, 2))
    rows = match_descriptors(one[1], other[1], cross_check=True, max_ratio=0.85, max_distance=0.3)
    return one[0][rows[:, 0]][:, ::-1].astype(float), other[0][rows[:, 1]][:, ::-1].astype(float)


def _aligned(
    picture: np.ndarray, other: np.ndarray, places: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The second places moved to where patches match best (Lucas and Kanade 1981, brightness and contrast free).

    Matches whose patch does not settle within a pixel and a half, or does not correlate at 0.8, are left out.
    """
    steps = np.arange(-_HALF, _HALF + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    weight = np.exp(-(dx**2 + dy**2) / (2 * (_HALF / 2) ** 2))
    weight /= weight.sum()
    first = _normal(_patches(picture, places, dx, dy), weight)
    slope_y, slope_x = np.gradient(gaussian_filter(other, 0.7))
    moved = others.copy()
    plain = gaussian_filter(other, 0.7)
    for _ in range(_TURNS):
        raw = _patches(plain, moved, dx, dy, smooth=False)
        spread = np.sqrt((weight * (raw - (weight * raw).sum(1, keepdims=True)) ** 2).sum(1, keepdims=True))
        slopes = (_patches(slope, moved, dx, dy, smooth=False) for slope in (slope_x, slope_y))
        gx, gy = (slope / np.maximum(spread, 1e-6) for slope in slopes)
        gx, gy = (g - (weight * g).sum(1, keepdims=True) for g in (gx, gy))
        off = first - _normal(raw, weight)
        a, b, c = ((weight * g * h).sum(1) for g, h in ((gx, gx), (gx, gy), (gy, gy)))
        p, q = (weight * gx * off).sum(1), (weight * gy * off).sum(1)
        determinant = np.maximum(a * c - b * b, 1e-9)
        step = np.stack([c * p - b * q, a * q - b * p], axis=1) / determinant[:, None]
        moved = moved + np.clip(step, -1, 1)
    likeness = (weight * first * _normal(_patches(plain, moved, dx, dy, smooth=False), weight)).sum(1)
    kept = (likeness > 0.8) & (np.linalg.norm(moved - others, axis=1) < 1.5)
    return places[kept], moved[kept]


def _patches(
    picture: np.ndarray, places: np.ndarray, dx: np.ndarray, dy: np.ndarray, smooth: bool = True
) -> np.ndarray:
    source = gaussian_filter(picture, 0.7) if smooth else picture
    at = [places[:, 1, None] + dy, places[:, 0, None] + dx]
    return np.asarray(map_coordinates(source, at, order=1, mode="nearest"), np.float64)


def _normal(patches: np.ndarray, weight: np.ndarray) -> np.ndarray:
    centred = patches - (weight * patches).sum(1, keepdims=True)
    return np.asarray(centred / np.maximum(np.sqrt((weight * centred**2).sum(1, keepdims=True)), 1e-6))
