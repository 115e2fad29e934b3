"""What light models gain at the maps and the sky of a short fit: interreflection, where Monte Carlo samples go; how
natural the sky is.

Interreflection: what leaving it out would cost under another light, since its share ends up in the base colour. On the
fitted views themselves nothing tells: diffuse interreflection looks the same from everywhere, so base colour
takes it up, a' = a I_n / I_(n-1). Under another light the same a' is wrong. Both follow from the operators of the light
transport at the maps and sky of a short fit, with no further fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from exmesh_graph.shading import brdf, envmap
from exmesh_graph.shading.monte_carlo import Sampler
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.stage2.light.sampled import SampledLight
from exmesh_graph.stage2.maps import Appearance
from exmesh_graph.stage2.pictures import encode_srgb
from exmesh_graph.stage2.probe.gain import Gain, paired_gain, sums_over_tiles
from exmesh_graph.stage2.probe.short import ShortFit

#: Quarter turns of the fitted sky stand for the other light; runs of neighbouring points are the clusters.
TURNS, CLUSTERS = (1, 2, 3), 16


@dataclass(frozen=True)
class Baked:
    """What the next interreflection changes.

    gain   expected gain of modelling it, in relit pictures whose error is otherwise that of the held-out pixels
    share  part of the points' light that is due to it, mean over what the pictures show
    """

    gain: Gain
    share: float


@torch.no_grad()
def baked_light(fit: ShortFit, bounces: int, held_error: float) -> Baked:
    """What `bounces` interreflections change over one fewer; `held_error`: mean squared error of held-out pixels."""
    light, maps = fit.light, fit.model.maps
    there = light.lattice_material(maps, maps.values())
    diffuse, sent = brdf.diffuse(there.base_color, there.metallic), light.lattice_sends(maps, maps.values())
    environment = envmap.radiance_of(fit.model.environment)
    weight = torch.zeros(len(diffuse))
    for buffer in fit.fitted:
        weight.index_add_(0, buffer.light.point.reshape(-1), buffer.light.point_weight.reshape(-1))
    fewer, more = _irradiance(fit, environment, sent, bounces)
    # points in the dark tell nothing: no picture shows their colour
    weight[more.amin(1) <= 1e-4 * float(more.mean())] = 0
    total = max(float(weight.sum()), 1e-12)
    share = float((weight * (1 - fewer / more.clamp_min(1e-12)).mean(1)).sum()) / total
    taken_up = (math.pi * diffuse * more / fewer.clamp_min(1e-12)).clamp(max=1) / math.pi
    scale = _median_ratio(diffuse, taken_up, weight)
    wrong = []
    for turn in TURNS:
        other = torch.roll(environment, turn * environment.shape[1] // (len(TURNS) + 1), dims=1)
        direct, full = _irradiance(fit, other, sent, bounces)
        error = (encode_srgb(diffuse * full) - encode_srgb(taken_up * scale * direct)) ** 2
        wrong.append((error.mean(1) * weight).double().numpy())
    cluster = np.arange(len(weight)) * CLUSTERS // len(weight)
    shown = np.bincount(cluster, weights=weight.double().numpy(), minlength=CLUSTERS)
    extra = np.bincount(cluster, weights=np.mean(wrong, axis=0), minlength=CLUSTERS)
    left = held_error * shown
    return Baked(paired_gain(left + extra, left, shown), share)


def _irradiance(
    fit: ShortFit, environment: torch.Tensor, diffuse: torch.Tensor, bounces: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Irradiance [P, 3] with one interreflection fewer, and with `bounces`."""
    binned = fit.light.binning(environment)
    return fit.irradiance(binned, diffuse, bounces - 1), fit.irradiance(binned, diffuse, bounces)


def _median_ratio(true: torch.Tensor, fitted: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """The factor per channel that scores take out of base colour: the median of true / fitted where pictures look."""
    used = weight > 0
    return (true[used] / fitted[used].clamp_min(1e-6)).median(dim=0).values if bool(used.any()) else torch.ones(3)


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
        pair = []
        for step in (2 * number, 2 * number + 1):
            prepared = light.prepare(Appearance(model.maps, values, environment, 0.0, step))
            pair.append(encode_srgb(light.radiance(seen, material, prepared)))
        wrong = ((pair[0] - pair[1]) ** 2).mean(1) / 2
        sums = sums_over_tiles(wrong.double().numpy(), buffer.pixel.numpy(), fit.size)
        errors.append(sums[0])
        counts.append(sums[1])
    return np.concatenate(errors), np.concatenate(counts)


def unnatural(environment: np.ndarray) -> float:
    """How much the light of an environment, radiance [H, W, 3], turns green and purple from side to side.

    Skies, suns, flames and lamps lie near the curve of black bodies, which runs from orange to blue (Judd, MacAdam and
    Wyszecki 1964 on daylight); across it, g = log G - (log R + log B) / 2 of the irradiance E(n). Returned is the
    spread (standard deviation over all normals n) of g, so that a tint of the whole light counts for nothing.
    """
    rows = 8
    coarse = envmap.resample(environment, rows, 2 * rows).reshape(-1, 3).astype(np.float64)
    toward = envmap.texel_directions(rows, 2 * rows).reshape(-1, 3)
    share = np.broadcast_to(np.asarray(envmap.solid_angles(rows, 2 * rows)).reshape(rows, -1), (rows, 2 * rows)).ravel()
    irradiance = (np.clip(toward @ toward.T, 0, None) * share) @ coarse
    red, green, blue = np.log(np.maximum(irradiance, 1e-6)).T
    across = green - (red + blue) / 2
    share = share / share.sum()
    return float(np.sqrt(share @ (across - share @ across) ** 2))
