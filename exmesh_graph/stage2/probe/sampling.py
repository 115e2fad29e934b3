"""Where the samples of the Monte Carlo light should go, from its noise at the maps and the sky of a short fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.shading.monte_carlo import Sampler
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.stage2.light.sampled import SampledLight
from exmesh_graph.stage2.objective import encode_srgb
from exmesh_graph.stage2.probe.compare import Gain, paired_gain, tiles_of
from exmesh_graph.stage2.probe.short import CLUSTERS, ShortFit

#: The paper's samples per pixel, and the views to look at.
SAMPLES, VIEWS = 8, 2


def sampling_gain(fit: ShortFit, technique: Sampler, seed: int) -> Gain:
    """By how many dB direct light is less noisy with `technique` than with the paper's environment samples."""
    before, pixels = _noise(fit, "environment", seed)
    after, _ = _noise(fit, technique, seed)
    return paired_gain(before, after, pixels)


@torch.no_grad()
def _noise(fit: ShortFit, technique: Sampler, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Half the squared difference of two independent estimates (display values) and pixels, summed over clusters."""
    model = fit.model
    settings = MonteCarloSettings(technique=technique, samples=SAMPLES, bounces=0)
    light = SampledLight(settings, model.geometry, fit.light.tracer, seed)
    values, environment = model.maps.values(), envmap.radiance_of(model.environment)
    errors, counts = [], []
    for number, buffer in enumerate(fit.fitted[:VIEWS]):
        seen = replace(buffer, light=light.view(buffer.samples(model.geometry), buffer.pixel, fit.size[1], number))
        material = model.maps.read(values, buffer.texel, buffer.texel_weight)
        pair = [
            encode_srgb(light.radiance(seen, material, light.prepare(model.maps, values, environment, 0.0, step)))
            for step in (2 * number, 2 * number + 1)
        ]
        wrong = ((pair[0] - pair[1]) ** 2).mean(1) / 2
        tile = tiles_of(buffer.pixel.numpy(), fit.size[1], fit.size[0], CLUSTERS)
        errors.append(np.bincount(tile, weights=wrong.double().numpy(), minlength=CLUSTERS**2))
        counts.append(np.bincount(tile, minlength=CLUSTERS**2).astype(np.float64))
    return np.concatenate(errors), np.concatenate(counts)
