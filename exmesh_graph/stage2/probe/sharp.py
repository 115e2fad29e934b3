"""Whether a fit starts from a low roughness: two fits that end apart, and the pixels that tell them apart.

Roughness and sky are found together. From a rough start a sky is found that is smooth enough for it, and under that no
texel gains by being smoother: both must move at once. A highlight is a hundredth of the pixels, and all others, with
their noise, hide it: white china gains 0.1 to 0.5 dB on all of them and 1 to 4 on those that the two fits show most
unlike. Where both fits end near each other the start does not matter, and the rough one is kept: the rough stay rough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from exmesh_graph.stage2.probe.decide import SIGMAS, pays
from exmesh_graph.stage2.probe.gain import Gain, paired_gain
from exmesh_graph.stage2.probe.short import Part, ShortFit
from exmesh_graph.stage2.schedule import GLOSSY
from exmesh_graph.types import Decision

#: Roughness that sharp reflections are looked for from, and that a fit starts with else (StartSettings).
SHARP, NEUTRAL = GLOSSY, 0.5
#: The share of the held-out pixels that is asked: those that the two fits show most unlike.
ASKED = 0.02
#: What these must gain [dB], in a quick look for whole fits to be made and in these, and by how much smoother the
#: surface must end on the mean. After a quick look the rough still gains: its texels come down the faster.
LEAST, SMOOTHER = 1.0, 0.1


@dataclass(frozen=True)
class Comparison:
    """What a fit from SHARP gains over one from NEUTRAL on the pixels that differ most, and how much smoother it is."""

    gain: Gain
    smoother: float

    def tells(self) -> bool:
        """Whether the two fits ended apart, and the sharp one nearer the photographs beyond doubt."""
        return self.smoother >= SMOOTHER and pays(self.gain, 1.0, least=LEAST)


def compared(neutral: ShortFit, low: ShortFit) -> Comparison:
    """Two fits of the same pictures."""
    unlike = [(a - b).abs().mean(1) for a, b in zip(neutral.held_pictures(), low.held_pictures(), strict=True)]
    known = torch.cat([values[used] for values, used in zip(unlike, neutral.known, strict=True)])
    bound = torch.quantile(known, 1 - ASKED) if len(known) else 0.0
    asked = [values > bound for values in unlike]
    (before, pixels), (after, _) = neutral.held_errors(asked), low.held_errors(asked)
    return Comparison(paired_gain(before, after, pixels), neutral.mean_roughness() - low.mean_roughness())


def find_sharp(
    quick: Callable[[], tuple[ShortFit, ShortFit]], splits: Sequence[Callable[[], tuple[ShortFit, ShortFit]]]
) -> list[Comparison]:
    """Comparisons of whole fits under one split of the views after the other, as long as they tell; the quick look's
    where it gives no hint. Each makes a fit from NEUTRAL and one from SHARP."""
    hint = compared(*quick())
    if hint.gain.gain <= LEAST:
        return [hint]
    found: list[Comparison] = []
    for split in splits:
        found.append(compared(*split()))
        if not found[-1].tells():
            break
    return found


def from_sharp(start: ShortFit, steps: int) -> ShortFit:
    """A fit of so many steps from SHARP."""
    return start.restarted(Part(roughness=SHARP)).run(steps)


def decide_sharp(found: Sequence[Comparison]) -> Decision:
    """The roughness that the fit starts from: SHARP where two splits of the views tell."""
    least = min(found, key=lambda one: one.gain.gain)
    smoother = min(one.smoother for one in found)
    on = len(found) > 1 and all(one.tells() for one in found)
    error = least.gain.error if math.isfinite(least.gain.error) else None
    told = "nothing that could be told" if error is None else f"{least.gain.gain:+.2f} ± {error:.2f} dB"
    where = f"the least of {len(found)} splits" if len(found) > 1 else "one split"
    reason = (
        f"A start from roughness {SHARP:g} in place of {NEUTRAL:g} brings {told} on the {100 * ASKED:.0f} % of the "
        f"held-out pixels that it changes most, and ends {smoother:.2f} smoother ({where}); "
        f"{LEAST:.2f} dB, {SIGMAS:g} times the error and {SMOOTHER:.2f} under two splits are asked."
    )
    evidence = {f"gain_of_split_{number}": one.gain.gain for number, one in enumerate(found, 1)}
    value = SHARP if on else NEUTRAL
    return Decision(value, least.gain.gain, error, 1.0, reason, evidence | {"smoother": smoother})
