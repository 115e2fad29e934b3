"""Whether a scene has metal, maybe a little of it: does it explain the held-out pixels that come out as metal?

Bumpers of chrome on a lacquered car are a twelfth of its pixels, and pictures gain a tenth of a decibel by them. But
where they are the gain is clear, and paint that was taken for metal is drawn worse where no fitted camera stood. So
the fits are as whole ones are, with texels of one colour that agree half way, and their metal's own pixels decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
METALLIC = {"metallic": True, "metal_weight": 0.1, "metal_share": 0.25}


@dataclass(frozen=True)
class Comparison:
    """Squared errors without and with a metallic map, and pixels, summed over C clusters of held-out ones [3, C]: of
    all of them, and of those that the second fit calls metal. `seconds` of a step of the second."""

    whole: np.ndarray
    metal: np.ndarray
    seconds: float

    @property
    def share(self) -> float:
        """Of the held-out pixels, those that come out as metal."""
        return float(self.metal[2].sum() / max(self.whole[2].sum(), 1.0))


def compared(start: ShortFit, steps: int) -> Comparison:
    """Fits without and with metal from `start` on, which agree half way."""
    without = start.restarted(Part()).agreeing(steps)
    with_ = start.restarted(Part(METALLIC | {"iterations": steps})).agreeing(steps)
    chosen = with_.held_metal()

    def table(only: Any) -> np.ndarray:
        errors, pixels = without.held_errors(only)
        return np.stack([errors, with_.held_errors(only)[0], pixels])

    return Comparison(table(None), table(chosen), with_.seconds_per_step)


def find_metal(
    begun: Callable[[bool, int, int], ShortFit], thorough: bool, tick: Callable[[], None]
) -> list[Comparison]:
    """The first split of the views, and where metal pays there on its own pixels, the second; `begun` makes the start
    of a split (False: the first) with so many views to fit and to keep out."""
    found: list[Comparison] = []
    fitted, held, steps = THOROUGH if thorough else QUICK
    for other in (False, True):
        found.append(compared(begun(other, fitted, held), steps))
        tick()
        if paired_gain(*found[-1].metal).gain <= 0:
            break
    return found


def decide_metal(found: Sequence[Comparison], cost: float) -> Decision:
    """On where both splits find metal and it pays on its own pixels, of both together; one split alone is no.

    cost  of a step with a metallic map, times one without
    """
    whole = paired_gain(*np.concatenate([one.whole for one in found], axis=1))
    share = min(one.share for one in found)
    evidence = {"gain_on_all": whole.gain, "share": share}
    gain = paired_gain(*np.concatenate([one.metal for one in found], axis=1))
    on = len(found) > 1 and share >= SHARE and whole.gain > 0 and pays(gain, cost, least=LEAST)
    if not share:
        reason = "No held-out pixel comes out as metal."
        return Decision(on, whole.gain, _known(whole), cost, reason, evidence)
    what = f"On the held-out pixels that come out as metal, {100 * share:.1f} % of all, a metallic map brings"
    need = f"{required(cost, LEAST):.2f} dB beyond the noise, on {100 * SHARE:.0f} % of the pixels and on all together"
    told = f"{gain.gain:+.2f} ± {gain.error:.2f} dB ({whole.gain:+.2f} on all)"
    reason = f"{what} {told}; metal brings at least {need}."
    return Decision(on, gain.gain, _known(gain), cost, reason, evidence)


def _known(gain: Gain) -> float | None:
    return gain.error if np.isfinite(gain.error) else None
