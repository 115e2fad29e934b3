"""Paired comparison of two fits by the errors of the same held-out pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Mean squared error (display values) below which nobody sees a difference: 50 dB. Added to both sides, so that two
#: nearly perfect fits are equal and not decibels apart.
FLOOR = 1e-5


@dataclass(frozen=True)
class Gain:
    """A gain in PSNR [dB] and its standard error [dB]; inf where there is nothing to estimate one from."""

    gain: float
    error: float


def paired_gain(without: np.ndarray, with_: np.ndarray, pixels: np.ndarray) -> Gain:
    """By how many dB the second fit is nearer to the held-out pixels than the first.

    without, with_  summed squared errors of C clusters of pixels under the two fits, float64 [C]
    pixels          how many each cluster has [C]

    The gain is that of all pixels together, 10 log10(sum without / sum with). Its standard error is the delete-one
    jackknife over clusters (Efron and Stein 1981): neighbouring pixels err alike, so clusters are counted, not pixels.
    """
    before, after = (values.astype(np.float64) + FLOOR * pixels for values in (without, with_))
    used = pixels > 0
    before, after = before[used], after[used]
    count = len(before)
    if count == 0:
        return Gain(0.0, math.inf)
    gain = 10 * math.log10(before.sum() / after.sum())
    if count < 2:
        return Gain(gain, math.inf)
    left_out = 10 * np.log10((before.sum() - before) / (after.sum() - after))
    spread = ((left_out - left_out.mean()) ** 2).sum() * (count - 1) / count
    return Gain(gain, math.sqrt(spread))


def tiles_of(pixel: np.ndarray, width: int, height: int, side: int) -> np.ndarray:
    """Number of the tile, of side x side over a picture, that each flat pixel lies in: int64 [N]."""
    row, column = pixel // width, pixel % width
    return (row * side // height) * side + column * side // width
