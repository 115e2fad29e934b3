"""Matches looked for again where a pair's geometry allows them: along epipolar lines, or about a plane's image.

COLMAP does so too (`guided_matching`), and compares every feature of one picture with every one of the other, also with
those far from the line. Here only descriptors of what lies near it are compared, which takes a fifth of the time.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

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

    Sums of products of bytes are exact in float32, and features are asked in their order: no thread and no processor
    changes a match.
    """
    import torch

    from exmesh_graph.gpu.warp_runtime import launch
    from exmesh_graph.io.kernels_guided import nearest_allowed

    if not len(first) or not len(second):
        return np.zeros((0, 2), int)
    mine, theirs = one.astype(np.float32), other.astype(np.float32)
    lengths = [np.maximum(np.linalg.norm(part, axis=1), 1) for part in (mine, theirs)]
    forth, back = _Nearest.of(len(first)), _Nearest.of(len(second))
    allowed = (_about if flat else _along)(first, second, matrix, near)
    held = [torch.from_numpy(np.ascontiguousarray(part)) for part in (second, *allowed, *lengths, *forth, *back)]
    for start in range(0, len(first), _ROWS):
        products = torch.from_numpy(mine[start : start + _ROWS] @ theirs.T)
        launch(nearest_allowed, 1, start, len(products), len(second), int(flat), products, *held)
    clear = np.flatnonzero(forth.clear())
    match = forth.which[clear]
    mutual = back.clear()[match] & (back.which[match] == clear)
    return np.stack([clear[mutual], match[mutual]], axis=1)


def _along(
    first: np.ndarray, second: np.ndarray, fundamental: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(epipolar lines [P, 3] in the second picture; [P] and [Q], whose sum is the square of what x2 F x1 may be, for
    Sampson's distance of at most `near`)."""
    ones, others = (np.concatenate([part, np.ones((len(part), 1))], axis=1) for part in (first, second))
    lines = ones @ fundamental.T
    widths = (np.square(part[:, :2]).sum(axis=1) for part in (lines, others @ fundamental))
    return lines, *(near**2 * part for part in widths)


def _about(
    first: np.ndarray, second: np.ndarray, homography: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(places [P, 3] to which the homography carries the first; `near` squared [P]; zeros [Q])."""
    carried = np.concatenate([first, np.ones((len(first), 1))], axis=1) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return carried / carried[:, 2:], np.full(len(first), near**2), np.zeros(len(second))


class _Nearest(NamedTuple):
    """Of features [P] the cosines of the nearest and the second nearest allowed, and `which` the nearest is."""

    best: np.ndarray
    second: np.ndarray
    which: np.ndarray

    @classmethod
    def of(cls, count: int) -> _Nearest:
        best, second = np.full((2, count), _NONE, np.float32)
        return cls(best, second, np.zeros(count, np.int32))

    def clear(self) -> np.ndarray:
        """bool [P]: the nearest is near, and clearly nearer than the second."""
        nearest, second = (np.arccos(np.clip(cosines, -1, 1)) for cosines in (self.best, self.second))
        return (nearest <= _FAR) & (nearest < _RATIO * second)
