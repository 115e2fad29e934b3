"""Pictures that bring nothing: blurred ones, and those in which nothing moved since the one before.

Both are judged against the set itself. Sharpness is the energy of second differences between neighbouring pixels over
that between pixels four apart, so that neither light nor contrast counts, and the least over four directions, so that
a blur by motion counts as one out of focus does.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exmesh_graph.io.images import read_raw

_SIDE, _THUMB = 1024, 200  # pixels: the longer side in which sharpness and movement are measured, at most
_APART = 4
_TILES = 6
_TEXTURE = 1 / 255  # mean slope of a tile that tells movement


def grey_of(codes: np.ndarray, side: int) -> np.ndarray:
    """float32 [h, w], display values in [0, 1] of [H, W, C], reduced by a whole factor to `side` pixels at most."""
    top = np.iinfo(codes.dtype).max if codes.dtype.kind == "u" else 1
    channels = min(codes.shape[2], 3)
    factor = -(-max(codes.shape[:2]) // side)
    height, width = (n // factor for n in codes.shape[:2])
    total = np.zeros((height, width), np.float32)
    for row in range(factor):
        for column in range(factor):
            part = codes[row : height * factor : factor, column : width * factor : factor, :channels]
            total += part.sum(axis=2, dtype=np.float32)
    return total / (top * channels * factor**2)


def sharpness(grey: np.ndarray) -> float:
    """Of [H, W]: near 0 for a blurred picture; NaN for one that shows nothing, or has less than 9 pixels a side."""
    if min(grey.shape) <= 2 * _APART:
        return float("nan")
    ratios = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        fine, coarse = (_energy(grey, step * down, step * right) for step in (1, _APART))
        ratios.append(fine / coarse if coarse > 1e-7 else np.nan)
    return float(np.min(ratios))


def displacement(one: np.ndarray, other: np.ndarray) -> float:
    """How far things moved between two pictures [h, w], in shares of the width, from below; NaN: it cannot be told.

    By the constancy of brightness: the change over the slope, mean over mean, tile by tile; nine tenths of the tiles
    moved by no more. What moves before a background that stays (a turntable) fills some tiles, so it counts.
    """
    if one.shape != other.shape:
        return float("nan")
    other = other * (one.mean() / max(float(other.mean()), 1e-6))  # exposure is not movement
    change = np.abs(one - other)
    down, right = np.gradient(one)
    slope = np.hypot(down, right)
    moved = []
    for rows in np.array_split(np.arange(one.shape[0]), _TILES):
        for columns in np.array_split(np.arange(one.shape[1]), _TILES):
            tile = np.ix_(rows, columns)
            if slope[tile].mean() > _TEXTURE:
                moved.append(change[tile].mean() / slope[tile].mean())
    return float(np.quantile(moved, 0.9)) / one.shape[1] if moved else float("nan")


def measure(pictures: Sequence[Path]) -> tuple[np.ndarray, list[np.ndarray]]:
    """(sharpness [N], the small pictures whose `displacement` is asked for) of files of the same kind."""
    thumbs, sharp = [], np.full(len(pictures), np.nan)
    for k, picture in enumerate(pictures):
        codes = read_raw(picture)
        sharp[k] = sharpness(grey_of(codes, _SIDE))
        thumbs.append(grey_of(codes, _THUMB))
    return sharp, thumbs


def choose(pictures: Sequence[Path], blurred: float, alike: float) -> tuple[list[int], list[int]]:
    """Indices of pictures to leave out: (blurred, alike), in the order of `pictures`, which is that of taking them.

    blurred  less than this share of the set's median sharpness is blurred; 0: none is
    alike    of neighbours in which nothing moves by this share of the width the less sharp goes; 0: none does
    """
    if blurred <= 0 and alike <= 0:
        return [], []
    sharp, thumbs = measure(pictures)
    told = np.isfinite(sharp)
    least = blurred * float(np.median(sharp[told])) if told.any() else 0.0
    soft = [k for k in range(len(pictures)) if told[k] and sharp[k] < least]
    twins: list[int] = []
    last: int | None = None
    for k in range(len(pictures)):
        if k in soft:
            continue
        if alike > 0 and last is not None and displacement(thumbs[last], thumbs[k]) < alike:
            worse, last = (last, k) if sharp[k] > sharp[last] else (k, last)
            twins.append(worse)
        else:
            last = k
    return soft, sorted(twins)


def _energy(grey: np.ndarray, down: int, right: int) -> float:
    """Mean square of second differences along (down, right)."""
    height, width = grey.shape
    across = abs(right)
    middle = grey[down : height - down, across : width - across]
    before = grey[: height - 2 * down, across - right : width - across - right]
    after = grey[2 * down :, across + right : width - across + right]
    return float(np.mean((before - 2 * middle + after).astype(np.float64) ** 2))
