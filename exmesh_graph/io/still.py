"""Features that stand still while others move: the room behind a turntable, as a camera on a tripod sees it.

What stands still in the pictures matches from one to the next better than the object, which turns. Cameras that are
found by it do not move at all. So it is taken out where the rest tells that something turns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

STILL = 0.002
"""Of a picture's longer side: matches nearer to one another stand still."""
TWICE = 3
"""Pictures in which a feature stands still, besides its own, from which on it is no chance."""
FEW = 20
"""Still features of a picture, and moving matches of a pair, that count."""
SHARE = 0.5
"""Of the pictures: so many must have still features, and so many be tied to another by what moves."""

Matches = Mapping[tuple[int, int], np.ndarray]


def without_still(colmap: Any, database: Path, seed: int = 0) -> float:
    """Share of the features of COLMAP's database that are taken out of it, with all matches; 0: it is left as it is.

    For a database with matches. Where some are taken out, the rest has to be matched again.
    """
    opened = colmap.Database.open(database)
    try:
        images = sorted(opened.read_all_images(), key=lambda image: image.image_id)
        sides = {image.image_id: _side(opened.read_camera(image.camera_id)) for image in images}
        keypoints = {number: np.asarray(opened.read_keypoints(number)) for number in sides}
        matches = dict(_matches(colmap, opened))
        still = still_features({n: k[:, :2] / sides[n] for n, k in keypoints.items()}, matches)
        if not turning(colmap, {n: k[:, :2] for n, k in keypoints.items()}, matches, still, seed):
            return 0.0
        descriptors = {number: opened.read_descriptors(number) for number in sides}
        for clear in ("keypoints", "descriptors", "matches", "two_view_geometries"):
            getattr(opened, f"clear_{clear}")()
        for number, gone in still.items():
            opened.write_keypoints(number, keypoints[number][~gone])
            opened.write_descriptors(number, _some(colmap, descriptors[number], ~gone))
    finally:
        opened.close()
    return float(np.concatenate(list(still.values())).mean())


def still_features(places: Mapping[int, np.ndarray], matches: Matches) -> dict[int, np.ndarray]:
    """bool [P] by picture: features that are matched at their own place in three other pictures or more.

    places   float [P, 2] by picture, over its longer side
    matches  int [M, 2] by pair of pictures: which features
    """
    count = {number: np.zeros(len(found), int) for number, found in places.items()}
    for (one, other), pairs in matches.items():
        at_rest = pairs[_at_rest(places[one], places[other], pairs)]
        np.add.at(count[one], at_rest[:, 0], 1)
        np.add.at(count[other], at_rest[:, 1], 1)
    return {number: found >= TWICE for number, found in count.items()}


def turning(
    colmap: Any, pixels: Mapping[int, np.ndarray], matches: Matches, still: Mapping[int, np.ndarray], seed: int = 0
) -> bool:
    """Whether something moves before what stands still: most pictures show both.

    pixels  float [P, 2] by picture. What moves is that of two pictures whose other matches one motion explains (a
            fundamental matrix, by RANSAC); in pictures of a still scene from one place these are matched by chance.
    """
    resting = {number for number, found in still.items() if found.sum() >= FEW}
    if len(resting) < SHARE * len(still):
        return False
    best: dict[int, tuple[int, tuple[int, int], np.ndarray]] = {}
    for pair, pairs in matches.items():
        one, other = pair
        left = pairs[~(still[one][pairs[:, 0]] | still[other][pairs[:, 1]])]
        for number in {one, other} & resting if len(left) >= FEW else ():
            if number not in best or len(left) > best[number][0]:
                best[number] = len(left), pair, left
    tied: dict[tuple[int, int], bool] = {}
    for _, pair, left in best.values():
        if pair not in tied:
            first, second = pixels[pair[0]][left[:, 0]], pixels[pair[1]][left[:, 1]]
            tied[pair] = _one_motion(colmap, first, second, seed)
    return sum(tied[pair] for _, pair, _ in best.values()) >= SHARE * len(still)


def _one_motion(colmap: Any, first: np.ndarray, second: np.ndarray, seed: int) -> bool:
    options = colmap.RANSACOptions()
    options.max_error, options.random_seed = 4.0, seed
    found = colmap.estimate_fundamental_matrix(first.astype(np.float64), second.astype(np.float64), options)
    return found is not None and found["num_inliers"] >= max(FEW, len(first) / 2)


def _at_rest(first: np.ndarray, second: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    return np.linalg.norm(first[pairs[:, 0]] - second[pairs[:, 1]], axis=1) < STILL


def _matches(colmap: Any, opened: Any) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    numbers, found = opened.read_all_matches()
    for number, pairs in zip(numbers, found, strict=True):
        yield colmap.pair_id_to_image_pair(number), np.asarray(pairs).reshape(-1, 2)


def _side(camera: Any) -> float:
    return float(max(camera.width, camera.height))


def _some(colmap: Any, descriptors: Any, kept: np.ndarray) -> Any:
    return colmap.FeatureDescriptors(descriptors.type, np.asarray(descriptors.data)[kept])
