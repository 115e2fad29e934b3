"""The probe: measures of the mesh and short fits with and without each part of the model, turned into decisions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.stage2.probe.decide import (
    LEAST_GAIN,
    decide_bounces,
    decide_environment,
    decide_light_first,
    decide_part,
    decide_sharp,
    decide_technique,
    decide_texture,
    pays,
    with_noise,
)
from exmesh_graph.stage2.probe.gain import Gain, Work, paired_gain
from exmesh_graph.stage2.probe.geometry import fed_side, measure_shape, texel_budget
from exmesh_graph.stage2.probe.light import baked_light, sampling_gain, unnatural
from exmesh_graph.stage2.probe.short import Part, ShortFit, sample_views
from exmesh_graph.types import Carrier, Decision, SceneNeeds, Views

Progress = Callable[[int, int], None]

#: Steps of the base fit and of each comparison, and the comparisons' share of the learning rates.
BASE_STEPS, STEPS, RATE = 150, 60, 0.3
#: Side of the probe's maps at most and at least; concavity below which the mesh does not see itself; most
#: interreflections; the skies to try beyond half the first.
TEXELS, LEAST_TEXELS, CONVEX, MOST_BOUNCES, SKIES = 128, 16, 1e-3, 3, (64, 128)
#: Roughness that sharp reflections are looked for from, and that a fit starts with else (StartSettings). What starting
#: low gains in a base fit [dB] before whole fits are made of it, their steps, and what it must gain in them: fits of
#: what is rough end alike from either (within 0.6 dB), fits from 0.5 of dark glaze stay 2 dB below.
SHARP, NEUTRAL = 0.2, 0.5
SHARP_HINT, LONG_STEPS, SHARP_LEAST = 0.8, 500, 1.0
#: Share of a fit's steps that move the light alone, where such steps are wanted.
LIGHT_FIRST = 0.25
#: Mean squared error (40 dB) below which no relit picture comes: the least that baked light is weighed against.
BEST_ERROR = 1e-4
#: The light transport that the counted cost of a step refers to: transport.direct's by default.
FULL = TransportSettings()


@dataclass(frozen=True)
class Candidate:
    """A part of the model that is on or off.

    settings  what the fit is told for it;  channels  that it adds to the maps;  what  sentences call it
    anew      compared by fits from the start on, where one that goes on would be caught in what it found without
    least     gain [dB] that it must bring at least; a part that is compared anew must bring it under another split of
              the views as well
    """

    name: str
    settings: dict[str, Any]
    channels: int
    what: str
    anew: bool = False
    least: float = LEAST_GAIN


#: Weight of undecided metallic (`metal_weight`) in the fit that metal is judged by. A gloss that the coat's model does
#: not have is matched by half metals; where each texel must be metal or none, that gain goes and that of metal stays.
DECIDED = {"metal_weight": 1.0, "iterations": BASE_STEPS}
#: Gain [dB] from which fits of BASE_STEPS are believed, and the steps of those that are asked below it. A quarter of a
#: metal everywhere brings up to 0.8 dB in the first and takes 0.2 to 1.0 in longer ones, where each texel has become
#: metal or none; the lid of `tin` brings 0.7 in the first and 0.6 to 1.4 in longer ones.
SURE, SURE_STEPS = 1.5, 300
#: To let the probe judge another switch of the fit, add a line. A dielectric taken for metal is wrong everywhere: what
#: metal brings where there is none (0.24 dB on rubber) is below what it brings where there is (0.37 dB and far more).
CANDIDATES = (Candidate("metallic", {"metallic": True} | DECIDED, 1, "A metallic map", anew=True, least=0.3),)


#: Fits at most, for the progress.
STAGES = 8 + len(CANDIDATES) + len(SKIES)


@dataclass(frozen=True)
class Probed:
    """The decisions, and seconds per step of the probe's own fits on this machine, by what was added to `reference`
    (or taken from it: `direct`)."""

    needs: SceneNeeds
    seconds: dict[str, float]


def probe_scene(
    carrier: Carrier, views: Views, *, seed: int = 0, thorough: bool = True, progress: Progress | None = None
) -> Probed:
    """Measure what `carrier`, seen by the training `views`, needs (docs/probe.md).

    thorough  whether to fit as long as `light_first` takes to be judged, which without it is 0

    Equal arguments give equal `needs` on a CPU. Raises DataError when no pixel sees the mesh.
    """
    return _Probe(carrier, views, seed, progress).run(thorough)


class _Probe:
    def __init__(self, carrier: Carrier, views: Views, seed: int, progress: Progress | None) -> None:
        self.carrier, self.views, self.seed = carrier, views, seed
        self.progress, self.steps = progress, 0
        self.sample = sample_views(views)
        self.fit = ShortFit(carrier, self.sample, self._side(), seed)
        self.shape = measure_shape(self.fit.transport, carrier.vertices, carrier.faces)
        self.decisions: dict[str, Decision] = {}
        self.long: ShortFit | None = None
        self.seconds: dict[str, float] = {}
        self.placebo = Gain(0.0, 0.0)
        self.work = self._texture()

    def run(self, thorough: bool = True) -> Probed:
        concave = self.shape.concavity >= CONVEX
        start = self.fit.forked(Part(bounces=int(concave)))
        self.fit = start.forked(Part()).run(BASE_STEPS)
        self._tick()
        anew = {c.name: [self._gain(self.fit, self._anew(start, c))] for c in CANDIDATES if c.anew}
        self._again(anew, start, int(concave))
        self._light_first(start, thorough)
        self._sharp(start, int(concave))
        self.fit.measure()
        reference = self._compared("reference", Part(), draw=1)
        self.placebo = self._gain(reference, self._compared("placebo", Part(), draw=2))
        if concave:
            reference = self._bounces(reference)
        else:
            self.decisions["bounces"] = decide_bounces([], [], Gain(0.0, 0.0), self.shape)
        for candidate in CANDIDATES:
            gains = anew.get(candidate.name) or [self._gain(reference, self._going_on(candidate))]
            self._decide(candidate, [with_noise(gain, self.placebo) for gain in gains])
        self._environment(reference)
        self.decisions["technique"] = decide_technique(sampling_gain(reference, "mis", self.seed))
        if self.progress:
            self.progress(STAGES, STAGES)
        geometry = {name: float(value) for name, value in vars(self.shape).items()}
        geometry |= {"placebo_gain": self.placebo.gain, "views": len(self.sample.views), "factor": self.sample.factor}
        return Probed(SceneNeeds(self.decisions, geometry), self.seconds)

    def _side(self) -> int:
        """Maps that the coarse pixels can feed."""
        alpha = self.sample.views.alpha[: self.sample.fitted]
        fed = fed_side(self.carrier, float((alpha > 0.5).sum()))
        return int(min(max(fed, LEAST_TEXELS), TEXELS))

    def _bounces(self, bounced: ShortFit) -> ShortFit:
        """Decide on interreflection; the fit that the other comparisons are made with."""
        direct = self._compared("direct", Part(bounces=0), draw=1)
        held = with_noise(self._gain(direct, bounced), self.placebo)
        errors, pixels = bounced.held_errors()
        left = max(float(errors.sum() / max(pixels.sum(), 1.0)), BEST_ERROR)
        counts = range(1, MOST_BOUNCES + 1)
        findings = [baked_light(bounced, count, left) for count in counts]
        work = self.work
        totals = [replace(work, bounces=count).total() for count in (0, *counts)]
        costs = [totals[count] / totals[count - 1] for count in counts]
        decision = decide_bounces(findings, costs, held, self.shape)
        self.decisions["bounces"] = decision
        self.work = replace(work, bounces=int(decision.value))
        if decision.value:
            return bounced
        self.fit = self.fit.forked(Part(bounces=0))
        return direct

    def _decide(self, candidate: Candidate, gains: list[Gain]) -> None:
        work = self.work
        cost = replace(work, channels=work.channels + candidate.channels).total() / work.total()
        self.decisions[candidate.name] = decide_part(gains, cost, candidate.what, candidate.least)

    def _again(self, gains: dict[str, list[Gain]], start: ShortFit, bounces: int) -> None:
        """Measure what pays once more with other views held out: fits that share neither held-out pixels nor base.
        What then pays by little must pay in longer fits under both splits, which else take their place."""
        hopeful = [c for c in CANDIDATES if c.name in gains and pays(gains[c.name][0], 1.0, least=c.least)]
        if not hopeful:
            return
        other = self._other(bounces)
        without = other.forked(Part()).run(BASE_STEPS)
        for candidate in hopeful:
            found = gains[candidate.name]
            found.append(self._gain(without, self._anew(other, candidate)))
            if all(pays(gain, 1.0, least=candidate.least) for gain in found) and min(g.gain for g in found) < SURE:
                longer = [self._longer(begun, candidate) for begun in (start, other)]
                if min(gain.gain for gain in longer) < candidate.least:
                    gains[candidate.name] = longer

    def _longer(self, start: ShortFit, candidate: Candidate) -> Gain:
        """What a candidate brings in fits of SURE_STEPS from `start` on."""
        settings = candidate.settings | {"iterations": SURE_STEPS}
        without = start.restarted(Part()).run(SURE_STEPS)
        with_ = start.restarted(Part(settings)).run(SURE_STEPS)
        self._tick()
        return self._gain(without, with_)

    def _other(self, bounces: int) -> ShortFit:
        """The beginning of fits under the second split of the views."""
        other = ShortFit(self.carrier, sample_views(self.views, other=True), self._side(), self.seed + 1)
        return other.forked(Part(bounces=bounces))

    def _light_first(self, start: ShortFit, thorough: bool) -> None:
        """Decide whether the fit's first steps move the light alone. What is the light's and what the paint's on walls
        of one normal each, no photograph tells: of two fits that explain the photographs alike, the one under the more
        natural light is kept."""
        if not thorough:
            reason = "Not looked at (thorough: false): base colour and light move from the first step."
            self.decisions["light_first"] = Decision(0.0, None, None, 1.0, reason)
            return
        together = self._long(start)
        alone = start.restarted(Part()).run(LONG_STEPS, light_first=LIGHT_FIRST)
        self._tick()
        terms = together.fitted_term(), alone.fitted_term()
        tints = unnatural(together.sky()), unnatural(alone.sky())
        self.decisions["light_first"] = decide_light_first(terms, tints, LIGHT_FIRST)

    def _long(self, start: ShortFit) -> ShortFit:
        """The long fit of the first split, made once."""
        if self.long is None:
            self.long = start.restarted(Part()).run(LONG_STEPS)
            self._tick()
        return self.long

    def _sharp(self, start: ShortFit, bounces: int) -> None:
        """Decide on the roughness to start from. From a rough start, a sky is found that is smooth enough for it, and
        under that no texel gains by being smoother: both must move at once."""

        def gain(neutral: ShortFit, begun: ShortFit, steps: int) -> Gain:
            low = begun.restarted(Part(roughness=SHARP)).run(steps)
            self._tick()
            return self._gain(neutral, low)

        gains = [gain(self.fit, start, BASE_STEPS)]
        if gains[0].gain > SHARP_HINT:
            gains = [gain(self._long(start), start, LONG_STEPS)]
            if pays(gains[0], 1.0, least=SHARP_LEAST):
                other = self._other(bounces)
                gains.append(gain(other.restarted(Part()).run(LONG_STEPS), other, LONG_STEPS))
        self.decisions["roughness"] = decide_sharp(gains, SHARP, NEUTRAL, SHARP_LEAST)

    def _anew(self, start: ShortFit, candidate: Candidate) -> ShortFit:
        tried = start.restarted(Part(candidate.settings)).run(BASE_STEPS)
        self.seconds[candidate.name] = tried.seconds_per_step
        self._tick()
        return tried

    def _going_on(self, candidate: Candidate) -> ShortFit:
        return self._compared(candidate.name, Part(candidate.settings), draw=1)

    def _environment(self, reference: ShortFit) -> None:
        tried_gains = []
        for rows in SKIES:
            tried = self._compared("environment_height", Part({"environment_height": rows}), draw=1)
            cost = replace(self.work, height=rows).total() / replace(self.work, height=rows // 2).total()
            tried_gains.append((rows, with_noise(self._gain(reference, tried), self.placebo), cost))
            if not pays(*tried_gains[-1][1:]):
                break
            reference = tried
        self.decisions["environment_height"] = decide_environment(tried_gains, SKIES[0] // 2)

    def _texture(self) -> Work:
        """Decide on the atlas; the counted work of a step at the sizes of a whole fit."""
        factor, light = self.sample.factor, self.fit.transport
        mean = sum(len(buffer.pixel) for buffer in self.fit.fitted) / self.sample.fitted * factor**2
        budget = texel_budget(self.carrier, self.fit.footprints() / factor**2, mean * len(self.views))
        self.decisions["texture_size"] = decide_texture(budget)
        finer = FULL.points * FULL.directions / (len(light.points) * len(light.directions))
        assert light.gather_point is not None
        return Work(
            pixels=mean,
            texels=mean * len(self.views) / max(budget.pixels_per_texel, 1e-6),
            points=FULL.points,
            directions=FULL.directions,
            entries=len(light.gather_point) * finer,
            height=SKIES[0] // 2,
        )

    def _compared(self, name: str, part: Part, draw: int) -> ShortFit:
        tried = self.fit.forked(part).run(STEPS, RATE, draw=draw)
        self.seconds[name] = tried.seconds_per_step
        self._tick()
        return tried

    def _gain(self, without: ShortFit, with_: ShortFit) -> Gain:
        errors, pixels = without.held_errors()
        return paired_gain(errors, with_.held_errors()[0], pixels)

    def _tick(self) -> None:
        self.steps += 1
        if self.progress:
            self.progress(min(self.steps, STAGES), STAGES)


def decision_rows(probed: Probed) -> dict[str, Any]:
    """The decisions as figures for the report: `decisions`, a list of rows, and measures of the mesh."""
    rows, seconds = [], probed.seconds
    for name, decision in probed.needs.decisions.items():
        row = {"name": name, **vars(decision)}
        if name == "bounces" and "direct" in seconds:
            row["seconds_ratio"] = seconds["reference"] / seconds["direct"]
        elif name in seconds:
            row["seconds_ratio"] = seconds[name] / seconds["reference"]
        rows.append(row)
    return {"decisions": rows, "geometry": dict(probed.needs.geometry)}
