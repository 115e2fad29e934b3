"""Whether a scene has metal, maybe a little of it: does it explain the held-out pixels that come out as metal?

Bumpers of chrome on a lacquered car are a twelfth of its pixels, and pictures gain a tenth of a decibel by them. But
where they are the gain is clear, and paint that was taken for metal is drawn worse where no fitted camera stood. So
the fits are as whole ones are, with texels of one colour that agree half way, and their metal's own pixels decide.
Where that leaves it open each texel is asked for itself: paint of the metal's colour would agree with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from exmesh_graph.stage2.probe.decide import pays, required
from exmesh_graph.stage2.probe.gain import Gain, paired_gain
from exmesh_graph.stage2.probe.short import Part, ShortFit
from exmesh_graph.types import Decision

#: Views to fit and to keep out, and steps. Metal mirrors what is where, so that few views do not show it from enough
#: sides, and after 200 steps nothing mirrors sharply yet: a quick look finds plain metal, and misses a little of it.
THOROUGH, QUICK = (24, 12, 400), (12, 4, 200)
#: What metal must bring on its own pixels [dB], and the share of all held-out ones that these must be.
LEAST, SHARE = 0.3, 0.02
#: A fit with a metallic map, as the graphs have it.
TOGETHER = {"metallic": True, "metal_weight": 0.1, "metal_share": 0.25, "metal_variation": 3.0}
#: One in which each texel decides for itself. White paint has the colour of steel: what agrees with it is metal until
#: the pictures bring it back, and here they have few steps to.
ALONE = TOGETHER | {"metal_share": 0.99}


@dataclass(frozen=True)
class Comparison:
    """Squared errors without and with a metallic map, and pixels, summed over C clusters of held-out ones [3, C]: of
    all of them, and of those that the second fit calls metal; None where these are too few to ask the first. `share`:
    of the held-out pixels, those that come out as metal; `seconds` of a step of the second; `alone`: whether each texel
    decided for itself."""

    share: float
    whole: np.ndarray | None
    metal: np.ndarray | None
    seconds: float
    alone: bool = False


class Split:
    """Some views to fit and others kept out, for fits from one start; the one without metal is made once."""

    def __init__(self, start: ShortFit, steps: int) -> None:
        self.start, self.steps, self.measured = start, steps, start.measured()
        self.without: list[torch.Tensor] | None = None

    def compared(self, way: dict[str, Any]) -> Comparison:
        """A fit with metal and, where that finds any, one without, of as many steps."""
        with_, shown = self._fitted(Part(way | {"iterations": self.steps}))
        chosen = with_.held_metal()
        (after, pixels), (metal, mine) = with_.held_errors(shown=shown), with_.held_errors(chosen, shown)
        share = float(mine.sum() / max(pixels.sum(), 1.0))
        seconds, alone = with_.seconds_per_step, way is ALONE
        if share < SHARE:
            return Comparison(share, None, None, seconds, alone)
        if self.without is None:
            self.without = self._fitted(Part())[1]
        before, bare = (self.start.held_errors(only, self.without)[0] for only in (None, chosen))
        whole, own = np.stack([before, after, pixels]), np.stack([bare, metal, mine])
        return Comparison(share, whole, own, seconds, alone)

    def _fitted(self, part: Part) -> tuple[ShortFit, list[torch.Tensor]]:
        """(a fit, what it shows where views are kept out)."""
        self.start.put_back(self.measured)  # corrections of the one fit are none of the other
        fit = self.start.restarted(part).agreeing(self.steps)
        return fit, fit.held_pictures()


def find_metal(
    begun: Callable[[bool, int, int], ShortFit], thorough: bool, tick: Callable[[], None]
) -> list[Comparison]:
    """The first split of the views, and where metal does not clearly lose there on its own pixels, the second; where
    both together leave it open, the same with each texel for itself, which counts if it finds metal.

    begun  makes the start of a split (False: the first) with so many views to fit and to keep out
    """
    fitted, held, steps = THOROUGH if thorough else QUICK
    splits: list[Split] = []
    found: list[Comparison] = []
    for other in (False, True):
        splits.append(Split(begun(other, fitted, held), steps))
        found.append(splits[-1].compared(TOGETHER))
        tick()
        if not _open(found[-1:]):
            return found
    if _clear(found) or not _open(found):
        return found
    alone = [split.compared(ALONE) for split in splits]
    return alone if _clear(alone) else found


def decide_metal(found: Sequence[Comparison], cost: float) -> Decision:
    """On where both splits find metal and it pays on its own pixels, of both together; one split alone is no.

    cost  of a step with a metallic map, times one without
    """
    share, gains = min(one.share for one in found), _gains(found)
    if gains is None:
        what = f"{100 * share:.1f} % of the held-out pixels come out as metal, under {100 * SHARE:.0f} %"
        return Decision(False, None, None, cost, f"{what}: no metal.", {"share": share})
    whole, gain = gains
    each = ", each texel for itself" if found[-1].alone else ""
    what = f"On the held-out pixels that come out as metal{each}, {100 * share:.1f} % of all, a metallic map brings"
    need = f"{required(cost, LEAST):.2f} dB beyond the noise, on {100 * SHARE:.0f} % of the pixels and on all together"
    told = f"{gain.gain:+.2f} ± {gain.error:.2f} dB ({whole.gain:+.2f} on all)"
    reason = f"{what} {told}; metal brings at least {need}."
    error = gain.error if np.isfinite(gain.error) else None
    return Decision(_clear(found, cost), gain.gain, error, cost, reason, {"gain_on_all": whole.gain, "share": share})


def _gains(found: Sequence[Comparison]) -> tuple[Gain, Gain] | None:
    """What metal brings on all held-out pixels and on its own, of all splits together; None where one finds none."""
    wholes = [one.whole for one in found if one.whole is not None]
    metals = [one.metal for one in found if one.metal is not None]
    if len(metals) < len(found):
        return None
    whole, own = (paired_gain(*np.concatenate(tables, axis=1)) for tables in (wholes, metals))
    return whole, own


def _open(found: Sequence[Comparison]) -> bool:
    """Whether there is metal that does not clearly lose."""
    gains = _gains(found)
    return gains is not None and gains[1].gain > -gains[1].error


def _clear(found: Sequence[Comparison], cost: float = 1.0) -> bool:
    """Whether two splits find metal that pays."""
    gains = _gains(found)
    return gains is not None and len(found) > 1 and gains[0].gain > 0 and pays(gains[1], cost, least=LEAST)
