"""Which pictures of many are worth matching: those whose largest features look alike, and those that matched before.

Matching all pairs grows with the square of the pictures. Of each the features of largest scale are compared first (Wu,
3DV 2013: preemptive matching): they are few, and seen from far and near alike. Pictures of which plain features found
nothing alike are not asked again with more costly ones, but for a picture that hardly any looked like.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

#: Features of a picture that are compared, and pictures before and after by name that are partners in any case.
LARGEST, BESIDE = 128, 2
_RATIO = 0.8
_LEAST = 3
#: Partners of a picture that matched before, below which it is matched with all again.
ENOUGH = 12


def likely_pairs(colmap: Any, database: Path, partners: int) -> list[tuple[str, str]]:
    """Pairs of names: for each picture of COLMAP's database the `partners` most alike, and its neighbours by name."""
    opened = colmap.Database.open(database)
    try:
        images = sorted(opened.read_all_images(), key=lambda image: image.name)
        names = [image.name for image in images]
        largest = [_largest(opened, image.image_id) for image in images]
    finally:
        opened.close()
    alike = likeness(largest)
    pairs = set()
    for i in range(len(names)):
        order = np.argsort(-alike[i], kind="stable")[:partners]
        near = range(max(0, i - BESIDE), min(len(names), i + BESIDE + 1))
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in (*order[alike[i][order] >= _LEAST], *near) if j != i}
    return [(names[i], names[j]) for i, j in sorted(pairs)]


def matched_pairs(colmap: Any, database: Path, enough: int = ENOUGH) -> list[tuple[str, str]]:
    """Pairs of names that are alike by COLMAP's database of matches (15 of them, verified or not), and all pairs of a
    picture that has fewer than `enough` such partners."""
    opened = colmap.Database.open(database)
    try:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        alike = {colmap.pair_id_to_image_pair(pair)
                 for pair, count in zip(*opened.read_num_matches(), strict=True) if count > 0}  # fmt: skip
    finally:
        opened.close()
    held = Counter(number for pair in alike for number in pair)
    few = [number for number in names if held[number] < enough]
    pairs = [*alike, *((number, other) for number in few for other in names if other != number)]
    named = (sorted((names[one], names[other])) for one, other in pairs)
    return sorted({(one, other) for one, other in named})


def likeness(descriptors: list[np.ndarray]) -> np.ndarray:
    """int [N, N]: features of two pictures (uint8 [P, 128] each) that are nearest to one another, and clearly so.

    Sums of products of bytes are exact in float32, so the counts do not depend on threads.
    """
    units = [one.astype(np.float32) for one in descriptors]
    lengths = [np.maximum(np.linalg.norm(one, axis=1), 1.0) for one in units]
    counts = np.zeros((len(units), len(units)), int)
    for i, first in enumerate(units):
        for j in range(i):
            if len(first) > 1 and len(units[j]) > 1:
                product = first @ units[j].T
                counts[i, j] = counts[j, i] = _mutual(product / lengths[i][:, None] / lengths[j][None])
    return counts


def _mutual(cosines: np.ndarray) -> int:
    best, back = cosines.argmax(axis=1), cosines.argmax(axis=0)
    rows = np.flatnonzero(back[best] == np.arange(len(best)))
    return int((_clear(cosines[rows]) & _clear(cosines[:, best[rows]].T)).sum())


def _clear(cosines: np.ndarray) -> np.ndarray:
    """bool [R]: the nearest of each row [R, P] is clearly nearer than the second."""
    angle = np.arccos(np.clip(np.partition(cosines, -2, axis=1)[:, -2:], -1, 1))
    return angle[:, 1] < _RATIO * angle[:, 0]


def _largest(opened: Any, number: int) -> np.ndarray:
    """uint8 [P, 128]: descriptors of the features of largest scale."""
    keypoints = np.asarray(opened.read_keypoints(number), np.float64)
    found = opened.read_descriptors(number)
    described = np.asarray(getattr(found, "data", found), np.uint8)
    if keypoints.shape[1] == 4:
        scale = keypoints[:, 2]
    else:  # an affine shape: x, y and a 2 x 2 matrix
        scale = np.abs(keypoints[:, 2] * keypoints[:, 5] - keypoints[:, 3] * keypoints[:, 4])
    return described[np.argsort(-scale, kind="stable")[:LARGEST]]
