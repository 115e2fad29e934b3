"""Which coarse start suits what is known of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from exmesh_graph.types import Decision

Method = Literal["hull", "tsdf", "pgsr", "sphere"]
LEAST_ITERATIONS, MOST_ITERATIONS = 500, 1500
ENOUGH_VIEWS = 15
_FIXED, _PER_PIXEL, _PER_BARE_PIXEL = 0.06, 1.9e-6, 3.5e-6
"""Processor seconds of an iteration of `init.pgsr`, without masks all of a picture is drawn (docs/coarse_start.md):
constants, not a measurement, so that equal parameters give equal results on every machine."""


@dataclass(frozen=True)
class Known:
    """What there is: `masks`, every view has one; `points`, `depths`: wired in; `pixels` of a picture as fitted."""

    views: int
    masks: bool
    points: bool
    depths: bool
    pixels: int


def choose(known: Known, seconds: float) -> tuple[Decision, Decision]:
    """(start, its iterations) for about `seconds` of processor time.

    Depth maps are fused. Else, where every view has a mask, planar Gaussians are fitted in the hull if the time pays
    for 500 iterations or more, and the hull is taken if not. Without masks Gaussians are fitted, from points or at
    random, for 500 iterations at least: from a sphere Stage I finds nothing where no outline tells it where to go.
    """
    each = _FIXED + (_PER_PIXEL if known.masks else _PER_BARE_PIXEL) * known.pixels
    paid = min(MOST_ITERATIONS, math.floor(seconds / each))
    evidence = {"views": known.views, "pixels": known.pixels, "seconds_an_iteration": each, "iterations_paid_for": paid}
    time = f"{seconds:g} s pay for {paid} iterations of planar Gaussians at {known.pixels} pixels"
    enough = paid >= LEAST_ITERATIONS
    method: Method
    if known.depths:
        method, why = "tsdf", "depth maps are wired in" + (", masks close what they do not see" if known.masks else "")
    elif known.masks and enough:
        method, why = "pgsr", f"every view has a mask, and {time}: they open what no outline shows"
    elif known.masks:
        method, why = "hull", f"every view has a mask; {time}, fewer than {LEAST_ITERATIONS}"
    else:
        source = "points are wired in" if known.points else "there are neither masks, points nor depth maps"
        method, why = "pgsr", f"{source}, and {time}"
        if not enough:
            why += f"; {LEAST_ITERATIONS}, some {LEAST_ITERATIONS * each:.0f} s, are the least that finds a surface"
            paid = LEAST_ITERATIONS
    start = Decision(method, None, None, 1.0, f"{why[0].upper()}{why[1:]}.", evidence)
    count = Decision(paid, None, None, 1.0, f"What {seconds:g} s pay for, {LEAST_ITERATIONS} to {MOST_ITERATIONS}.", {})
    return start, count


def surface_row(gain: float, error: float) -> dict[str, Any]:
    """The decision between the hull and what Gaussians carved out of it, as a row for the report.

    gain, error  by how many dB photographs that were left out are foretold better over the carved surface, and its
                 standard error (exmesh_graph.evaluate.metrics.rephotography.compared)
    """
    value = "gaussians" if gain > 0 else "hull"
    better = "the surface of the Gaussians" if gain > 0 else "the hull"
    reason = f"Left-out photographs are foretold better over {better}, by {abs(gain):.2f} +- {error:.2f} dB."
    return {"name": "surface", "value": value, "gain": gain, "error": error, "reason": reason}


def reduction(width: int, height: int, side: int) -> int:
    """The least whole factor by which a picture's longer side comes down to `side` pixels."""
    return max(1, math.ceil(max(width, height) / side))
