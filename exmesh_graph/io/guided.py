"""Matches looked for again where a pair's geometry allows them: along epipolar lines, or about a plane's image.

COLMAP does so too (`guided_matching`), and compares every feature of one picture with every one of the other, also with
those far from the line. Here only what lies near it is asked, which takes a third of the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

NEAR = 4.0
"""Pixels from the epipolar lines (Sampson's distance), or from where a plane carries the feature."""
LEAST = 15
"""Matches of a pair that count, as COLMAP's of which a geometry is made."""
_RATIO, _FAR = 0.8, 0.7
"""Angle to the nearest descriptor over that to the second, and that to the nearest in radians, at most."""
_ROWS = 256
_NONE = -2.0


def match_guided(colmap: Any, database: Path, threads: int = 1) -> None:
    """Replace the verified matches of each pair of COLMAP's database by those that its geometry allows.

    How many threads share the pairs changes no byte.
    """
    kinds = colmap.TwoViewGeometryConfiguration
    flat = kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC
    opened = colmap.Database.open(database)
    try:
        pictures = {image.image_id: _Picture.read(opened, image) for image in opened.read_all_images()}
        read = zip(*opened.read_two_view_geometries(), strict=True)
        found = [(colmap.pair_id_to_image_pair(pair), one) for pair, one in read if len(one.inlier_matches)]

        def again(pair: tuple[int, int], geometry: Any) -> np.ndarray:
            one, other = (pictures[number] for number in pair)
            described = one.described, other.described
            if geometry.config in flat:
                return matches_along(one.places, other.places, *described, np.asarray(geometry.H), NEAR, flat=True)
            if geometry.config == kinds.CALIBRATED:
                near = (one.near + other.near) / 2
                return matches_along(one.normalised, other.normalised, *described, np.asarray(geometry.E), near)
            return matches_along(one.places, other.places, *described, np.asarray(geometry.F), NEAR)

        # threads of BLAS within these threads would wait for one another by spinning
        with threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(threads) as pool:
            matched = pool.map(lambda held: again(*held), found)
            for (pair, geometry), matches in zip(found, matched, strict=True):
                geometry.inlier_matches = matches.astype(np.uint32)
                enough = len(matches) >= LEAST
                opened.update_two_view_geometry(*pair, geometry if enough else colmap.TwoViewGeometry())
    finally:
        opened.close()


@dataclass(frozen=True)
class _Picture:
    """Features of a picture: `places` [P, 2] in pixels and `normalised` without the lens, in which NEAR pixels are
    `near`; their descriptors uint8 [P, 128]."""

    places: np.ndarray
    normalised: np.ndarray
    near: float
    described: np.ndarray

    @classmethod
    def read(cls, opened: Any, image: Any) -> _Picture:
        camera = opened.read_camera(image.camera_id)
        places = np.asarray(opened.read_keypoints(image.image_id), np.float64)[:, :2]
        found = opened.read_descriptors(image.image_id)
        described = np.asarray(getattr(found, "data", found), np.uint8)
        normalised = np.asarray(camera.cam_from_img(places)).reshape(-1, 2) if len(places) else places
        return cls(places, normalised, float(camera.cam_from_img_threshold(NEAR)), described)


def matches_along(
    first: np.ndarray,
    second: np.ndarray,
    one: np.ndarray,
    other: np.ndarray,
    matrix: np.ndarray,
    near: float,
    *,
    flat: bool = False,
) -> np.ndarray:
    """int [M, 2]: features that are nearest to one another among those the pair's geometry allows, and clearly so.

    first, second  [P, 2] and [Q, 2], their places (x, y), in pixels or without the lens
    one, other     uint8 [P, 128] and [Q, 128], their descriptors
    matrix         [3, 3], fundamental or essential (x2 F x1 = 0) or, of a `flat` scene, the homography from the first
    near           how far a match may be from what the matrix says, in the unit of the places

    Sums of products of bytes are exact in float32, so no thread and no processor changes a match.
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), int)
    forth = _Nearest(len(first))
    back = _Nearest(len(second))
    allowed = _about(first, second, matrix, near) if flat else _along(first, second, matrix, near)
    every = np.arange(len(second))
    mine, theirs = one.astype(np.float32), other.astype(np.float32)
    length, theirs_length = (np.maximum(np.linalg.norm(part, axis=1), 1.0) for part in (mine, theirs))
    for rows, there in allowed:
        cosines = mine[rows] @ theirs.T / length[rows, None] / theirs_length
        cosines[~there] = _NONE
        forth.see(rows, every, cosines.T)
        back.see(every, rows, cosines)
    clear = np.flatnonzero(forth.clear())
    match = forth.which[clear]
    mutual = back.clear()[match] & (back.which[match] == clear)
    return np.stack([clear[mutual], match[mutual]], axis=1)


def _along(
    first: np.ndarray, second: np.ndarray, fundamental: np.ndarray, near: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Parts of the features of the first picture, and bool [R, Q]: those of the second within `near` pixels of their
    epipolar lines (Sampson's distance)."""
    ones, others = (np.concatenate([part, np.ones((len(part), 1))], axis=1) for part in (first, second))
    forth = ones @ fundamental.T  # lines in the second picture
    back = np.square(others @ fundamental[:, :2]).sum(axis=1)
    for rows in _parts(len(first)):
        scale = near**2 * (np.square(forth[rows, :2]).sum(axis=1)[:, None] + back)
        yield rows, np.square(forth[rows] @ others.T) <= scale


def _about(
    first: np.ndarray, second: np.ndarray, homography: np.ndarray, near: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The same with those within `near` pixels of where the homography carries them."""
    carried = np.concatenate([first, np.ones((len(first), 1))], axis=1) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        carried = carried[:, :2] / carried[:, 2:]
    for rows in _parts(len(first)):
        yield rows, np.square(carried[rows, None] - second).sum(axis=-1) <= near**2


def _parts(count: int) -> Iterator[np.ndarray]:
    for start in range(0, count, _ROWS):
        yield np.arange(start, min(start + _ROWS, count))


class _Nearest:
    """Of features [P] the cosines of the nearest and the second nearest that were seen, and `which` the nearest is."""

    def __init__(self, count: int) -> None:
        self._best, self._second = np.full((2, count), _NONE, np.float32)
        self.which = np.zeros(count, int)

    def see(self, features: np.ndarray, others: np.ndarray, cosines: np.ndarray) -> None:
        """Take in the cosines [O, F] of `features` [F] with `others` [O]."""
        at = cosines.argmax(axis=0), np.arange(len(features))
        best = cosines[at]
        cosines[at] = _NONE
        second = np.maximum(cosines.max(axis=0), self._second[features])
        cosines[at] = best
        held = self._best[features]
        nearer = best > held
        self._second[features] = np.maximum(second, np.where(nearer, held, best))
        self._best[features] = np.where(nearer, best, held)
        self.which[features] = np.where(nearer, others[at[0]], self.which[features])

    def clear(self) -> np.ndarray:
        """bool [P]: the nearest is near, and clearly nearer than the second."""
        nearest, second = (np.arccos(np.clip(cosines, -1, 1)) for cosines in (self._best, self._second))
        return (nearest <= _FAR) & (nearest < _RATIO * second)
