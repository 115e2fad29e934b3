"""Features that stand still while others move: the room behind a turntable, as a camera on a tripod sees it.

What stands still in the pictures matches from one to the next better than the object, which turns. Cameras that are
found by it do not move at all. So it is taken out where the rest tells that something turns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

STILL = 0.002
"""Of a picture's longer side: matches nearer to one another stand still."""
_THRICE = 3
"""Pictures in which a feature stands still, besides its own, from which on it is no chance."""
_FEW = 20
"""Still features of a picture, and moving matches of a pair, that count."""
_SHARE = 0.5
"""Of the pictures: so many must have still features, and so many be tied to another by what moves."""

_AROUND = 10
"""Features nearest to a pixel that say whether it stands still."""
_CELL = 4
"""Pixels on a side of the squares that are told apart."""

Matches = Mapping[tuple[int, int], np.ndarray]


def turning_masks(colmap: Any, database: Path, seed: int = 0) -> dict[str, np.ndarray]:
    """By picture's name bool [H, W], what turns before what stands still; empty where nothing does.

    For COLMAP's database of features and matches, of which it changes nothing. A pixel belongs to what stands still
    where most of the features nearest to it do: features that match nothing lie among those that do.
    """
    opened = colmap.Database.open(database)
    try:
        images = sorted(opened.read_all_images(), key=lambda image: image.image_id)
        sizes = {image.image_id: _size(opened.read_camera(image.camera_id)) for image in images}
        pixels = {number: np.asarray(opened.read_keypoints(number), np.float64)[:, :2] for number in sizes}
        matches = dict(_matches(colmap, opened))
    finally:
        opened.close()
    places = {number: found / max(sizes[number]) for number, found in pixels.items()}
    rest = still_features(places, matches, 1)
    if not turning(colmap, pixels, matches, still_features(places, matches), rest, seed):
        return {}
    return {image.name: _moving(pixels[image.image_id], rest[image.image_id], sizes[image.image_id])
            for image in images}  # fmt: skip


def still_features(places: Mapping[int, np.ndarray], matches: Matches, least: int = _THRICE) -> dict[int, np.ndarray]:
    """bool [P] by picture: features that are matched at their own place in `least` other pictures or more.

    places   float [P, 2] by picture, over its longer side
    matches  int [M, 2] by pair of pictures: which features
    """
    count = {number: np.zeros(len(found), int) for number, found in places.items()}
    for (one, other), pairs in matches.items():
        at_rest = pairs[_at_rest(places[one], places[other], pairs)]
        np.add.at(count[one], at_rest[:, 0], 1)
        np.add.at(count[other], at_rest[:, 1], 1)
    return {number: found >= least for number, found in count.items()}


def turning(
    colmap: Any,
    pixels: Mapping[int, np.ndarray],
    matches: Matches,
    still: Mapping[int, np.ndarray],
    rest: Mapping[int, np.ndarray],
    seed: int = 0,
) -> bool:
    """Whether something moves before what stands still: most pictures show both.

    pixels       float [P, 2] by picture
    still, rest  bool [P] by picture: at rest in three other pictures, and in one
    What moves is seen in two pictures where one motion explains the matches of features that are nowhere at rest (a
    fundamental matrix, by RANSAC); in pictures of a still scene from one place these are matched by chance.
    """
    resting = {number for number, found in still.items() if found.sum() >= _FEW}
    if len(resting) < _SHARE * len(still):
        return False
    best: dict[int, tuple[int, tuple[int, int], np.ndarray]] = {}
    for pair, pairs in matches.items():
        one, other = pair
        left = pairs[~(rest[one][pairs[:, 0]] | rest[other][pairs[:, 1]])]
        for number in {one, other} & resting if len(left) >= _FEW else ():
            if number not in best or len(left) > best[number][0]:
                best[number] = len(left), pair, left
    tied: dict[tuple[int, int], bool] = {}
    for _, pair, left in best.values():
        if pair not in tied:
            first, second = pixels[pair[0]][left[:, 0]], pixels[pair[1]][left[:, 1]]
            tied[pair] = _one_motion(colmap, first, second, seed)
    return sum(tied[pair] for _, pair, _ in best.values()) >= _SHARE * len(still)


def _one_motion(colmap: Any, first: np.ndarray, second: np.ndarray, seed: int) -> bool:
    options = colmap.RANSACOptions()
    options.max_error, options.random_seed = 4.0, seed
    found = colmap.estimate_fundamental_matrix(first.astype(np.float64), second.astype(np.float64), options)
    return found is not None and found["num_inliers"] >= max(_FEW, len(first) / 2)


def _at_rest(first: np.ndarray, second: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    return np.linalg.norm(first[pairs[:, 0]] - second[pairs[:, 1]], axis=1) < STILL


def _matches(colmap: Any, opened: Any) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    numbers, found = opened.read_all_matches()
    for number, pairs in zip(numbers, found, strict=True):
        yield colmap.pair_id_to_image_pair(number), np.asarray(pairs).reshape(-1, 2)


def _size(camera: Any) -> tuple[int, int]:
    return camera.height, camera.width


def _moving(pixels: np.ndarray, rest: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """bool `size`: where fewer than half of the nearest features (pixels [P, 2], x and y) are at `rest` bool [P]."""
    if not len(rest):
        return np.ones(size, bool)
    height, width = size
    x, y = np.meshgrid(np.arange(_CELL / 2, width, _CELL), np.arange(_CELL / 2, height, _CELL))
    near = cKDTree(pixels).query(np.stack([x, y], axis=-1), k=min(_AROUND, len(rest)))[1].reshape(*x.shape, -1)
    moving = rest[near].mean(axis=-1) < 0.5
    return moving.repeat(_CELL, axis=0).repeat(_CELL, axis=1)[:height, :width]
