"""What a part of the model gains, by the errors of the same held-out pixels, and what it costs, in counted work."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Mean squared error (display values) below which nobody sees a difference: 50 dB. Added to both sides, so that two
#: nearly perfect fits are equal and not decibels apart.
FLOOR = 1e-5
#: Tiles along a held-out picture's side: the clusters of the paired comparison.
TILES = 4


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


def sums_over_tiles(errors: np.ndarray, pixel: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Errors [N] of flat pixels [N] in a picture of `size` (height, width), and how many, summed over its tiles."""
    tile = tiles_of(pixel, size[1], size[0], TILES)
    return (
        np.bincount(tile, weights=errors, minlength=TILES**2),
        np.bincount(tile, minlength=TILES**2).astype(np.float64),
    )


def tiles_of(pixel: np.ndarray, width: int, height: int, side: int) -> np.ndarray:
    """Number of the tile, of side x side over a picture, that each flat pixel lies in: int64 [N]."""
    row, column = pixel // width, pixel % width
    return (row * side // height) * side + column * side // width


@dataclass(frozen=True)
class Work:
    """The work of one step of the fit, counted: equal on every machine, where seconds are not.

    Numbers that a step reads or writes, forward and backward, up to a common factor.

    pixels     of a view on the object;  channels of the maps;  texels that are parameters
    points, directions, entries, bounces   of the light transport (entries: of its interreflection operator)
    height     rows of the environment
    """

    pixels: float
    texels: float
    points: float
    directions: float
    entries: float
    channels: int = 4
    bounces: int = 0
    height: int = 64

    def total(self) -> float:
        """A pixel reads 4 texels, 3 points of 3 channels and 8 rows of the prefiltered sky, and is shaded in some 40
        numbers; Adam touches a parameter 7 times; a bounce reads every entry for 3 channels, both ways; the sky is
        filtered to 8 levels by matrices over its rows.
        """
        pixel = 4 * self.channels + 9 + 24 + 40
        sky = 8 * 3 * self.height**2 * 2
        return (
            3 * pixel * self.pixels
            + 7 * self.channels * self.texels
            + 2 * self.points * self.directions
            + 2 * (3 * self.entries + 9 * self.points) * self.bounces
            + 3 * sky
        )
