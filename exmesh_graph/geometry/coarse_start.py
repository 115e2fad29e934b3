"""Which coarse start suits what is known of a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from exmesh_graph.types import Decision

Method = Literal["hull", "tsdf", "stereo", "pgsr", "sphere"]
LEAST_ITERATIONS, MOST_ITERATIONS = 500, 1500
ENOUGH_VIEWS = 15
_FIXED, _PER_PIXEL, _PER_BARE_PIXEL = 0.06, 1.9e-6, 3.5e-6
"""Processor seconds of an iteration of `init.pgsr`, without masks all of a picture is drawn (docs/coarse_start.md):
constants, not a measurement, so that equal parameters give equal results on every machine."""
_STEREO_FIXED, _STEREO_PER_PIXEL, _STEREO_PER_BARE_PIXEL = 20.0, 4e-6, 9e-6
"""Processor seconds of `prior.patch_match` with masks and of carving by it: the second for each pixel of each view."""


@dataclass(frozen=True)
class Known:
    """What there is: `masks`, every view has one; `points`, `depths`: wired in; `pixels` of a picture as fitted;
    `stereo`: its depth was found already."""

    views: int
    masks: bool
    points: bool
    depths: bool
    pixels: int
    stereo: bool = False


def choose(known: Known, seconds: float) -> tuple[Decision, Decision]:
    """(start, its iterations) for about `seconds` of processor time.

    Depth maps are fused. Else stereo carves the hull where every view has a mask, if the time pays for it, and the hull
    is taken as it is if not. Without masks the depth of stereo is fused. Gaussians are fitted where they are asked for.
    """
    each = _FIXED + (_PER_PIXEL if known.masks else _PER_BARE_PIXEL) * known.pixels
    paid = min(MOST_ITERATIONS, math.floor(seconds / each))
    rate = _STEREO_PER_PIXEL if known.masks else _STEREO_PER_BARE_PIXEL
    stereo = _STEREO_FIXED + rate * known.views * known.pixels
    evidence = {"views": known.views, "pixels": known.pixels, "seconds_an_iteration": each, "iterations_paid_for": paid,
                "seconds_of_stereo": stereo}  # fmt: skip
    method: Method
    if known.depths:
        method, why = "tsdf", "depth maps are wired in" + (", masks close what they do not see" if known.masks else "")
    elif known.stereo:
        asked = "with the masks" if known.masks else "when masks were looked for"
        method, why = "stereo", f"its depth was found {asked}"
    elif not known.masks:
        source = "points are wired in" if known.points else "there are neither masks, points nor depth maps"
        method, why = "stereo", f"{source}: depth of stereo is fused, in some {stereo:.0f} s"
    else:
        takes = f"every view has a mask, and stereo takes some {stereo:.0f} s"
        if stereo <= seconds:
            method, why = "stereo", f"{takes} of {seconds:g}: it opens what no outline shows"
        else:
            method, why = "hull", f"{takes}, more than {seconds:g}"
    paid = max(paid, LEAST_ITERATIONS)
    start = Decision(method, None, None, 1.0, f"{why[0].upper()}{why[1:]}.", evidence)
    count = Decision(paid, None, None, 1.0, f"What {seconds:g} s pay for, {LEAST_ITERATIONS} to {MOST_ITERATIONS}.", {})
    return start, count


#: What a method of init.auto makes its surface of.
SURFACES = {"stereo": "stereo", "pgsr": "gaussians"}
_BY = {"stereo": "stereo", "gaussians": "the Gaussians"}
_TOLD = {
    "hull": "the hull",
    "stereo": "the surface that stereo carved",
    "gaussians": "the surface of the Gaussians",
}
#: dB that pits bring under gloss, where photographs agree on what is mirrored: 0.2 (`flask`); and that a rough inside
#: of a vessel brings over a smooth one that is nearer the truth: 0.5 (`mug`).
BENT, ROUGH = 0.3, 0.6


def better(gain: tuple[float, float], detail: tuple[float, float], least: float = BENT) -> bool:
    """Whether a carved surface foretells photographs better than the one kept so far, as `surface_row` says."""
    return gain[0] > max(gain[1], least) and not detail[0] < -detail[1]


def bolder(gain: tuple[float, float], detail: tuple[float, float]) -> bool:
    """Whether a surface of which more was taken is better than that of the careful choice: by three standard errors,
    and by two in its details, for what gloss seems to hide shows none."""
    return gain[0] > 3 * gain[1] and detail[0] > 2 * detail[1]


def surface_row(
    gain: tuple[float, float], detail: tuple[float, float], found: str, kept: str = "hull", least: float = BENT
) -> dict[str, Any]:
    """The decision between the surface `kept` so far and what `found` ("gaussians", "stereo") carved out of the hull,
    as a row for the report.

    gain    by how many dB photographs that were left out are foretold better over the carved surface, and its standard
            error (exmesh_graph.evaluate.metrics.rephotography.gain): within it, or up to `least`, it is none
    detail  the same of details alone: a surface that loses some, beyond the standard error, is pitted under gloss
    """
    by, error = gain
    chosen = better(gain, detail, least)
    ahead, other = (found, kept) if by > 0 else (kept, found)
    reason = (
        f"Left-out photographs are foretold better over {_TOLD[ahead]} than over {_TOLD[other]}, "
        f"by {abs(by):.2f} +- {error:.2f} dB"
    )
    if by > 0 and not chosen:
        small = "the doubt of it" if error >= least else _BRINGS[least]
        worse = f"but details worse, by {-detail[0]:.2f} +- {detail[1]:.2f} dB, as over pits under gloss"
        reason += f", {worse}" if by > max(error, least) else f": no more than {small}"
        reason += f", so {_TOLD[kept]} stays"
    value = found if chosen else kept
    return {"name": "surface", "value": value, "gain": by, "error": error, "detail": detail[0], "reason": f"{reason}."}


_BRINGS = {
    BENT: f"pits under gloss bring ({BENT:.2f} dB)",
    ROUGH: f"a rough inside of a vessel brings ({ROUGH:.2f} dB)",
}


def uncarved_row(found: str, kept: str = "hull") -> dict[str, Any]:
    """The same where photographs let nothing go of what `found` would carve."""
    reason = f"Photographs are foretold worse wherever {_BY[found]} would carve, so {_TOLD[kept]} stays."
    return {"name": "surface", "value": kept, "gain": 0.0, "error": 0.0, "detail": 0.0, "reason": reason}


def openings_row(found: Sequence[tuple[np.ndarray, float, float, float, Any]]) -> dict[str, Any]:
    """What was opened in the surface, as a row for the report.

    found  of each opening: where its lid faces [3], the lid's radius, wall and depth of the hollow, world units, and
           the gain (exmesh_graph.evaluate.metrics.opened.Gain)
    """
    told = [
        f"Through a lid of radius {radius:.2f} that faces ({', '.join(f'{part:.1f}' for part in normal)}) photographs "
        f"are foretold {gain.share:.0%} better ({gain.sigmas:.1f} standard errors): a hollow {depth:.2f} deep behind "
        f"walls of {wall:.2f}{f', by their detail as well, foretold {gain.detail:.0%} better' if gain.detail else ''}."
        for normal, radius, wall, depth, gain in found
    ]
    evidence = {f"{number}.{name}": value for number, (*_, gain) in enumerate(found, 1)
                for name, value in vars(gain).items()}  # fmt: skip
    reason = " ".join(told) or "No flat part of the surface is foretold better as the mouth of a vessel."
    return {"name": "openings", "value": str(len(found) or "none"), "reason": reason, "evidence": evidence}


_MIRRORED = 0.04
_COMPARED = 0.004


def mirror_row(share: float, compared: float) -> dict[str, Any]:
    """Whether what the photographs show is mirrored, as a row for the report; "likely" is to be warned of.

    share, compared  exmesh_graph.evaluate.metrics.agreement.reflected; scenes for choosing have shares of 0.001 to
                     0.016, a mirror ball 0.08
    """
    likely = share > _MIRRORED and compared > _COMPARED
    reason = (
        f"Of the windows on which neighbouring photographs agree, {share:.1%} show something else from about 35 "
        f"degrees away (more than {_MIRRORED:.0%} tell of mirrors)."
    )
    if likely:
        reason += (
            " What stereo found there are reflections, and the surface is wrong. Dull it (chalk or scanning spray, "
            "talcum powder), or photograph it under crossed polarisers; where it must stay as it is, give masks, which "
            "place its outline without looking at what it mirrors (mask.files, or masks/ beside the pictures)."
        )
    return {"name": "mirrors", "value": "likely" if likely else "none", "reason": reason,
            "evidence": {"share": share, "compared": compared}}  # fmt: skip


def reduction(width: int, height: int, side: int) -> int:
    """The least whole factor by which a picture's longer side comes down to `side` pixels."""
    return max(1, math.ceil(max(width, height) / side))
