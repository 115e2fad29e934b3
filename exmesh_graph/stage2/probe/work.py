"""The work of one step of the fit, counted: equal on every machine, where seconds are not."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Work:
    """Numbers that a step reads or writes, forward and backward, up to a common factor.

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
