"""The probe: measures of the mesh and short fits with and without each part of the model, turned into decisions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.stage2.key_light import find_key_light
from exmesh_graph.stage2.moving import Moves, axis_for, tell
from exmesh_graph.stage2.probe.decide import (
    decide_bounces,
    decide_environment,
    decide_key_light,
    decide_light_first,
    decide_moving,
    decide_technique,
    decide_texture,
    pays,
    with_noise,
)
from exmesh_graph.stage2.probe.gain import Gain, Work, paired_gain
from exmesh_graph.stage2.probe.geometry import fed_side, measure_shape, texel_budget
from exmesh_graph.stage2.probe.light import baked_light, sampling_gain, unnatural
from exmesh_graph.stage2.probe.metal import decide_metal, find_metal
from exmesh_graph.stage2.probe.sharp import decide_sharp, find_sharp, from_sharp
from exmesh_graph.stage2.probe.short import FITTED, HELD, Part, Sample, ShortFit, sample_views, traced
from exmesh_graph.types import Carrier, Decision, SceneNeeds, Views

Progress = Callable[[int, int], None]

#: Steps of the base fit and of each comparison, and the comparisons' share of the learning rates.
BASE_STEPS, STEPS, RATE = 150, 60, 0.3
#: Side of the probe's maps at most and at least; concavity below which the mesh does not see itself; most
#: interreflections; the skies to try beyond half the first.
TEXELS, LEAST_TEXELS, CONVEX, MOST_BOUNCES, SKIES = 128, 16, 1e-3, 3, (64, 128)
#: Steps of the long fits.
LONG_STEPS = 500
#: What a light that moves may leave of what one that stands leaves (stage2.moving) for fits to be made of it, and what
#: these must gain [dB].
MOVING_HINT, MOVING_LEAST = 0.9, 0.5
#: Share of a fit's steps that move the light alone, where such steps are wanted.
LIGHT_FIRST = 0.25
#: Mean squared error (40 dB) below which no relit picture comes: the least that baked light is weighed against.
BEST_ERROR = 1e-4
#: The light transport that the counted cost of a step refers to: transport.direct's by default.
FULL = TransportSettings()


#: Fits at most, for the progress.
STAGES = 11 + len(SKIES)


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

    thorough  whether to fit as long as `light_first` takes to be judged, which without it is 0, and a little metal

    Equal arguments give equal `needs` on a CPU. Raises DataError when no pixel sees the mesh.
    """
    return _Probe(carrier, views, seed, progress).run(thorough)


class _Probe:
    def __init__(self, carrier: Carrier, views: Views, seed: int, progress: Progress | None) -> None:
        self.carrier, self.views, self.seed = carrier, views, seed
        self.progress, self.steps = progress, 0
        self.sample = sample_views(views)
        self.transport = traced(carrier)
        self.decisions: dict[str, Decision] = {}
        self.axis, self.key = self._moving(), None
        if self.axis is None:  # shade that moves is in no texture
            found = find_key_light(carrier, self.transport)
            self.decisions["key_light"] = decide_key_light(found)
            self.key = found if self.decisions["key_light"].value else None
        else:
            self.decisions["key_light"] = Decision(False, None, None, 1.0, "The light moves with the camera.")
        self.fit = self._fit(self.sample)
        self.shape = measure_shape(self.transport, carrier.vertices, carrier.faces)
        self.long: ShortFit | None = None
        self.seconds: dict[str, float] = {}
        self.placebo = Gain(0.0, 0.0)
        self.work = self._texture()

    def run(self, thorough: bool = True) -> Probed:
        concave = self.shape.concavity >= CONVEX
        start = self.fit.forked(Part(bounces=int(concave)))
        self.fit = start.forked(Part()).run(BASE_STEPS)
        self._tick()
        metal = find_metal(partial(self._begun, int(concave)), thorough, self._tick)
        self.seconds["metallic"] = metal[-1].seconds
        self._light_first(start, thorough)
        self._sharp(start, int(concave))
        self.fit.measure()
        reference = self._compared("reference", Part(), draw=1)
        self.placebo = self._gain(reference, self._compared("placebo", Part(), draw=2))
        if concave:
            reference = self._bounces(reference)
        else:
            self.decisions["bounces"] = decide_bounces([], [], Gain(0.0, 0.0), self.shape)
        more = replace(self.work, channels=self.work.channels + 1)
        self.decisions["metallic"] = decide_metal(metal, more.total() / self.work.total())
        self._environment(reference)
        self.decisions["technique"] = decide_technique(sampling_gain(reference, "mis", self.seed))
        if self.progress:
            self.progress(STAGES, STAGES)
        geometry = {name: float(value) for name, value in vars(self.shape).items()}
        geometry |= {"placebo_gain": self.placebo.gain, "views": len(self.sample.views), "factor": self.sample.factor}
        return Probed(SceneNeeds(self.decisions, geometry), self.seconds)

    def _fit(self, sample: Sample, *, other: bool = False) -> ShortFit:
        """A fit of the sample from its start."""
        side, seed = self._side(sample), self.seed + other
        return ShortFit(self.carrier, sample, side, seed, self.transport, self.key, self.axis)

    def _moving(self) -> np.ndarray | None:
        """Decide what the light moves with: where colours hint at it, short fits under one that stands and under those
        that move. Returns the axis (types.Asset.light_axis)."""
        told, views = tell(self.carrier, self.sample.views), self.sample.views
        gains: dict[Moves, Gain] = {}
        if told is not None and told.hint() < MOVING_HINT:
            self.axis = self.key = None
            still = self._fit(self.sample).run(BASE_STEPS)
            moves: list[Moves] = ["camera"] if told.turntable is None else ["turntable", "camera"]
            for name in moves:
                self.axis = axis_for(name, views)
                gains[name] = self._gain(still, self._fit(self.sample).run(BASE_STEPS))
        self.decisions["light_moves"] = decide_moving(told, gains, MOVING_HINT, MOVING_LEAST)
        return next((axis_for(name, views) for name in gains if name == self.decisions["light_moves"].value), None)

    def _side(self, sample: Sample) -> int:
        """Maps that the coarse pixels can feed."""
        alpha = sample.views.alpha[: sample.fitted]
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

    def _begun(self, bounces: int, other: bool, fitted: int = FITTED, held: int = HELD) -> ShortFit:
        """The beginning of fits under the first or the `other` split of some views."""
        sample = sample_views(self.views, fitted, held, other=other)
        return self._fit(sample, other=other).forked(Part(bounces=bounces))

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
        """Decide on the roughness to start from."""

        def pair(neutral: ShortFit, begun: ShortFit, steps: int) -> tuple[ShortFit, ShortFit]:
            low = from_sharp(begun, steps)
            self._tick()
            return neutral, low

        def other() -> tuple[ShortFit, ShortFit]:
            begun = self._begun(bounces, other=True)
            return pair(begun.restarted(Part()).run(LONG_STEPS), begun, LONG_STEPS)

        splits = [lambda: pair(self._long(start), start, LONG_STEPS), other]
        self.decisions["roughness"] = decide_sharp(find_sharp(lambda: pair(self.fit, start, BASE_STEPS), splits))

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
