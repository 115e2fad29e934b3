"""From measured gains to decisions: a part is modelled where it pays beyond doubt and beyond its cost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from exmesh_graph.stage2.key_light import counts, described
from exmesh_graph.stage2.moving import Moves, Told
from exmesh_graph.stage2.probe.gain import Gain
from exmesh_graph.stage2.probe.geometry import ShapeMeasures, TexelBudget
from exmesh_graph.stage2.probe.light import Baked
from exmesh_graph.stage2.start_light import KeyLight
from exmesh_graph.types import Decision

#: A gain must exceed this many standard errors, this many dB, and what the same work buys when it is spent on more
#: steps instead: 0.25 dB of held-out PSNR for twice the steps (docs/stage2_trials.md, 400 against 1000 steps).
SIGMAS, LEAST_GAIN, GAIN_PER_DOUBLING = 2.0, 0.05, 0.25
#: The same for interreflection: it adds no unknown that could fit noise, and its predicted gain is never below zero.
#: The spread between parts of a surface, of which only some see others, is large where it matters most.
SIGMAS_OF_LIGHT = 1.0

#: Of an image term and of a light's green and purple after steps of the light alone, over those without: the first at
#: most as high, since it moves by two hundredths from mesh to mesh; the second is clear from here down (docs/probe.md).
ALIKE, CLEARLY = 1.0, 0.95


def required(cost: float, least: float = LEAST_GAIN) -> float:
    """The gain [dB] that a part must bring whose steps take `cost` times the work, at least `least`."""
    return max(least, GAIN_PER_DOUBLING * math.log2(max(cost, 1.0)))


def pays(gain: Gain, cost: float, sigmas: float = SIGMAS, least: float = LEAST_GAIN) -> bool:
    """Whether a gain is beyond its noise and its cost."""
    return gain.gain > max(sigmas * gain.error, required(cost, least))


def with_noise(gain: Gain, placebo: Gain) -> Gain:
    """`gain` with the noise of the fit itself in its error: what another order of the views alone changed."""
    return Gain(gain.gain, math.hypot(gain.error, placebo.gain))


def decide_part(gains: Sequence[Gain], cost: float, what: str, least: float = LEAST_GAIN) -> Decision:
    """Whether to switch a part on, by the held-out pixels; `what` the reason calls it.

    gains  under one split of the views or under several, of which the least counts: each must pay, and bring `least`
    """
    gain = min(gains, key=lambda one: one.gain)
    on = all(pays(one, cost, least=least) for one in gains)
    evidence = {f"gain_of_split_{number}": one.gain for number, one in enumerate(gains, 1)} if len(gains) > 1 else {}
    where = "held-out pixels" + (f", the least of {len(gains)} splits of the views" if len(gains) > 1 else "")
    return Decision(on, *_finite(gain), cost, _reason(what, where, gain, cost, on, least), evidence)


def decide_light_first(terms: tuple[float, float], tints: tuple[float, float], share: float) -> Decision:
    """The share of the steps that move the light alone: `share` where the photographs are explained no worse after it
    and the light found is clearly more natural (light.unnatural), else 0.

    terms, tints  the image term and the measure of the light, of a fit without such steps and of one with them
    """
    longer, greener = (after / max(before, 1e-9) for before, after in (terms, tints))
    on = longer <= ALIKE and greener <= CLEARLY
    found = f"{100 * (longer - 1):+.0f} % of the image term and {100 * (greener - 1):+.0f} % of green and purple light"
    need = f"{100 * (ALIKE - 1):+.0f} % and {100 * (CLEARLY - 1):+.0f} % at most"
    reason = f"Moving the light alone at first changes {found}; taken at {need}."
    return Decision(share if on else 0.0, None, None, 1.0, reason, {"image_ratio": longer, "tint_ratio": greener})


def decide_key_light(found: KeyLight) -> Decision:
    """Whether the fit starts with the light that `stage2.key_light` found."""
    evidence = {"strength": found.strength, "reach": float(found.reach), "share_explained": found.gain}
    return Decision(counts(found), None, None, 1.0, described(found), evidence)


def decide_moving(told: Told | None, gains: Mapping[Moves, Gain], hint: float, least: float) -> Decision:
    """What the light moves with: the `gains` of short fits under it over one under a light that stands decide, where
    colours gave a `hint` so clear that such fits were made."""
    if told is None:
        return Decision(False, None, None, 1.0, "No place is seen by views enough to tell whether the light moves.")
    evidence = {name: value for name, value in told._asdict().items() if value is not None}
    if not gains:
        reason = f"A light that moves with the camera explains no more ({told.hint():.2f}, asked from {hint:g} down)."
        return Decision(False, None, None, 1.0, reason, evidence)
    best = max(gains, key=lambda name: gains[name].gain)
    evidence |= {f"gain_of_{name}": gain.gain for name, gain in gains.items()}
    with_what = "a turntable" if best == "turntable" else "the camera"
    found = decide_part([gains[best]], 1.0, f"Light that moves with {with_what}", least)
    return replace(found, value=best if found.value else False, evidence=evidence)


def decide_bounces(findings: list[Baked], costs: list[float], held: Gain, shape: ShapeMeasures) -> Decision:
    """How many interreflections to model: as many as pay, one after the other.

    findings, costs  of the first, second, ... interreflection; `held`: what the first gains on held-out pixels
    """
    evidence = {"concavity": shape.concavity, "blocked": shape.blocked, "occluded": shape.occluded}
    if not findings:
        return Decision(0, 0.0, 0.0, 1.0, "No two parts of the mesh see each other.", evidence)
    first = findings[0]
    evidence |= {"share_of_light": first.share, "held_out_gain": held.gain}
    if math.isfinite(held.error):
        evidence["held_out_error"] = held.error
    best = first.gain
    count = 0
    for number, (finding, cost) in enumerate(zip(findings, costs, strict=True), start=1):
        gain = finding.gain
        if number == 1 and pays(held, cost) and held.gain > gain.gain:
            gain = best = held  # where base colour cannot take the light up, the photographs themselves tell
        if number > 1:
            evidence[f"gain_of_bounce_{number}"] = gain.gain
        if not pays(gain, cost, SIGMAS_OF_LIGHT):
            break
        count = number
    reason = _reason("Interreflection", "pictures under another light", best, costs[0], count > 0)
    if count > 1:
        reason = reason[:-1] + f"; {count} interreflections pay."
    return Decision(count, *_finite(best), costs[0], reason, evidence)


def decide_environment(gains: list[tuple[int, Gain, float]], lowest: int) -> Decision:
    """The smallest of ever finer environments that a finer one does not beat; `gains`: (rows, gain, cost)."""
    value, shown, cost = lowest, Gain(0.0, 0.0), 1.0
    evidence = {}
    for rows, gain, price in gains:
        evidence[f"gain_of_{rows}"] = gain.gain
        if value == lowest or pays(gain, price):
            shown, cost = gain, price
        if not pays(gain, price):
            break
        value = rows
    rows = gains[0][0] if value == lowest else value
    reason = _reason(f"A sky of {rows} rows instead of {rows // 2}", "held-out pixels", shown, cost, value > lowest)
    return Decision(value, *_finite(shown), cost, reason, evidence)


def decide_technique(gain: Gain) -> Decision:
    """Where the direct samples of the Monte Carlo light go, as many either way: by its noise."""
    on = pays(gain, 1.0)
    reason = _reason("Sampling light and lobes together (MIS)", "the noise of direct light", gain, 1.0, on)
    return Decision("mis" if on else "environment", *_finite(gain), 1.0, reason)


def decide_texture(budget: TexelBudget) -> Decision:
    """The atlas whose texels are as large as the finest pixels, or as all pixels together can feed."""
    reason = (
        f"The finest quarter of the pixels covers {budget.pixel_side:.3g} scene units a side; "
        f"texels of this atlas are as large, with {budget.pixels_per_texel:.1f} pixels of all views each."
    )
    evidence = {"pixel_side": budget.pixel_side, "pixels_per_texel": budget.pixels_per_texel}
    return Decision(budget.texture_size, None, None, 1.0, reason, evidence)


def _reason(what: str, where: str, gain: Gain, cost: float, on: bool, least: float = LEAST_GAIN) -> str:
    if not math.isfinite(gain.error):
        return f"{what} could not be judged: too few held-out pixels lie on what was fitted."
    number = f"{gain.gain:+.2f} ± {gain.error:.2f} dB on {where}"
    need = f"{required(cost, least):.2f} dB that {100 * (cost - 1):.0f} % more work must bring"
    if on:
        return f"{what} brings {number}, more than its noise and the {need}."
    if gain.gain <= required(cost, least):
        return f"{what} brings {number}, less than the {need}."
    return f"{what} brings {number}, which is within its noise."


def _finite(gain: Gain) -> tuple[float, float | None]:
    return gain.gain, gain.error if math.isfinite(gain.error) else None
