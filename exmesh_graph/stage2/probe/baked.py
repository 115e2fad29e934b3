"""What leaving interreflection out would cost under another light: its share ends up in the base colour.

On the fitted views themselves nothing tells: diffuse interreflection looks the same from everywhere, so base colour
takes it up, a' = a I_n / I_(n-1). Under another light the same a' is wrong. Both follow from the operators of the light
transport at the maps and sky of a short fit, with no further fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from exmesh_graph.shading import envmap
from exmesh_graph.stage2.objective import encode_srgb
from exmesh_graph.stage2.probe.compare import Gain, paired_gain
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
    diffuse = light.lattice_diffuse(maps, maps.values())
    environment = envmap.radiance_of(fit.model.environment)
    weight = torch.zeros(len(diffuse))
    for buffer in fit.fitted:
        weight.index_add_(0, buffer.light.point.reshape(-1), buffer.light.point_weight.reshape(-1))
    fewer, more = _irradiance(fit, environment, diffuse, bounces)
    # points in the dark tell nothing: no picture shows their colour
    weight[more.amin(1) <= 1e-4 * float(more.mean())] = 0
    total = max(float(weight.sum()), 1e-12)
    share = float((weight * (1 - fewer / more.clamp_min(1e-12)).mean(1)).sum()) / total
    taken_up = (math.pi * diffuse * more / fewer.clamp_min(1e-12)).clamp(max=1) / math.pi
    scale = _median_ratio(diffuse, taken_up, weight)
    wrong = []
    for turn in TURNS:
        other = torch.roll(environment, turn * environment.shape[1] // (len(TURNS) + 1), dims=1)
        direct, full = _irradiance(fit, other, diffuse, bounces)
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
    binned = torch.sparse.mm(fit.light.binning, environment.reshape(-1, 3))
    return fit.irradiance(binned, diffuse, bounces - 1), fit.irradiance(binned, diffuse, bounces)


def _median_ratio(true: torch.Tensor, fitted: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """The factor per channel that scores take out of base colour: the median of true / fitted where pictures look."""
    used = weight > 0
    return (true[used] / fitted[used].clamp_min(1e-6)).median(dim=0).values if bool(used.any()) else torch.ones(3)
