"""Whether a scene has metal, maybe a little of it: does it explain the held-out pixels that come out as metal?

Bumpers of chrome on a lacquered car are a twelfth of its pixels, and pictures gain a tenth of a decibel by them. But
where they are the gain is clear, and paint that was taken for metal is drawn worse where no fitted camera stood. So
the fits are as whole ones are, with texels of one colour that agree half way, and their metal's own pixels decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from exmesh_graph.stage2.probe.decide import pays, required
from exmesh_graph.stage2.probe.gain import paired_gain
from exmesh_graph.stage2.probe.short import Part, ShortFit
from exmesh_graph.types import Decision

#: Views to fit and to keep out, and steps. Metal mirrors what is where, so that few views do not show it from enough
#: sides, and after 200 steps nothing mirrors sharply yet: a quick look finds plain metal, and misses a little of it.
THOROUGH, QUICK = (24, 12, 400), (12, 4, 200)
#: What metal must bring on its own pixels [dB], and the share of all held-out ones that these must be.
LEAST, SHARE = 0.3, 0.02
#: A fit with a metallic map, as the graphs have it.
METALLIC = {"metallic": True, "metal_weight": 0.1, "metal_share": 0.25, "metal_variation": 3.0}


@dataclass(frozen=True)
class Comparison:
    """Squared errors without and with a metallic map, and pixels, summed over C clusters of held-out ones [3, C]: of
    all of them, and of those that the second fit calls metal; None where these are too few to ask the first. `share`:
    of the held-out pixels, those that come out as metal; `seconds` of a step of the second."""

    share: float
    whole: np.ndarray | None
    metal: np.ndarray | None
    seconds: float


def compared(start: ShortFit, steps: int) -> Comparison:
    """Fits with metal and, where that finds any, without from `start` on, which agree half way."""
    measured = start.measured()
    with_ = start.restarted(Part(METALLIC | {"iterations": steps})).agreeing(steps)
    chosen = with_.held_metal()
    (after, pixels), (metal, mine) = with_.held_errors(), with_.held_errors(chosen)
    share = float(mine.sum() / max(pixels.sum(), 1.0))
    if share < SHARE:
        return Comparison(share, None, None, with_.seconds_per_step)
    start.put_back(measured)  # corrections of the one fit are none of the other
    without = start.restarted(Part()).agreeing(steps)
    whole = np.stack([without.held_errors()[0], after, pixels])
    return Comparison(share, whole, np.stack([without.held_errors(chosen)[0], metal, mine]), with_.seconds_per_step)


def find_metal(
    begun: Callable[[bool, int, int], ShortFit], thorough: bool, tick: Callable[[], None]
) -> list[Comparison]:
    """The first split of the views, and where metal does not clearly lose there on its own pixels, the second; `begun`
    makes the start of a split (False: the first) with so many views to fit and to keep out."""
    found: list[Comparison] = []
    fitted, held, steps = THOROUGH if thorough else QUICK
    for other in (False, True):
        found.append(compared(begun(other, fitted, held), steps))
        tick()
        metal = found[-1].metal
        if metal is None or (gain := paired_gain(*metal)).gain <= -gain.error:
            break
    return found


def decide_metal(found: Sequence[Comparison], cost: float) -> Decision:
    """On where both splits find metal and it pays on its own pixels, of both together; one split alone is no.

    cost  of a step with a metallic map, times one without
    """
    share = min(one.share for one in found)
    wholes = [one.whole for one in found if one.whole is not None]
    metals = [one.metal for one in found if one.metal is not None]
    if len(metals) < len(found):
        what = f"{100 * share:.1f} % of the held-out pixels come out as metal, under {100 * SHARE:.0f} %"
        return Decision(False, None, None, cost, f"{what}: no metal.", {"share": share})
    whole, gain = (paired_gain(*np.concatenate(tables, axis=1)) for tables in (wholes, metals))
    on = len(found) > 1 and whole.gain > 0 and pays(gain, cost, least=LEAST)
    what = f"On the held-out pixels that come out as metal, {100 * share:.1f} % of all, a metallic map brings"
    need = f"{required(cost, LEAST):.2f} dB beyond the noise, on {100 * SHARE:.0f} % of the pixels and on all together"
    told = f"{gain.gain:+.2f} ± {gain.error:.2f} dB ({whole.gain:+.2f} on all)"
    reason = f"{what} {told}; metal brings at least {need}."
    error = gain.error if np.isfinite(gain.error) else None
    return Decision(on, gain.gain, error, cost, reason, {"gain_on_all": whole.gain, "share": share})
