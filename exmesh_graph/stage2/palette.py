"""Base colours drawn to the paints that they gather about.

What of the light a fit has not found yet stays in base colour: shadows, the shade of a wall that has one normal, what
surfaces send one another. It spreads what is one paint to all sides of the colour that most of it has. So at times each
texel moves to the mode of the colours about its own, and the light alone goes on for a while: it explains what the
pictures now miss, as far as light can. What a paint itself varies by, the pictures bring back after that.

Modes are those of a Gaussian density of logarithms (mean shift; Comaniciu and Meer 2002).
"""

from __future__ import annotations

import math

import numpy as np
import torch

from exmesh_graph.stage2 import metal
from exmesh_graph.stage2.gains import BRIGHTEST
from exmesh_graph.stage2.init import NARROW_MARGIN, logit
from exmesh_graph.stage2.maps import LOG_FLOOR, MaterialMaps
from exmesh_graph.stage2.schedule import learning_rates
from exmesh_graph.stage2.settings import DecompositionSettings

#: When colours gather, as shares of the fit's steps: from when the light has its shape; where texels agree on metal,
#: after that only, for half metals are of no paint. For how long the light then moves alone, and how far (logits) steps
#: must still take a texel after that: a few do not bring paint back (docs/stage2_trials.md).
WHEN, WAIT, REACH = (0.4, 0.6, 0.8), 0.1, 1.5
#: How much wider the colours of metal gather in whole fits: nothing paints it, what varies is what it mirrors.
METAL_WIDER = 3.0
#: Cells of the density's grid in a width, and along an axis at most; steps of the climb.
FINE, LONGEST, CLIMB = 2, 128, 30


def gathering(settings: DecompositionSettings, step: int) -> bool:
    """Whether colours gather before this step; never under a light that is known."""
    return step in _moments(settings)


def light_follows(settings: DecompositionSettings, step: int) -> bool:
    """Whether maps and the common factor wait in this step for the light."""
    wait = round(WAIT * settings.iterations)
    return any(moment <= step < moment + wait for moment in _moments(settings))


@torch.no_grad()
def gather_colors(maps: MaterialMaps, seen: torch.Tensor, width: float, wider: float = 1.0) -> float:
    """Move each base colour to the mode of its like, metal and paint apart; how bright they are on the whole stays.

    seen   float [T], how much pixels tell of each texel (`gbuffer.Evidence.weight`)
    width  of the Gaussian that a colour counts with, in the logarithm of base colour; for metal `wider` times that
    Returns by how much logarithms moved on the mean, of the texels that pixels see.
    """
    values, weight = maps.values().double().cpu().numpy(), seen.double().cpu().numpy()
    place = np.log(values[:, :3] + LOG_FLOOR)
    metal = values[:, 4] > 0.5 if maps.settings.metallic else np.zeros(len(values), bool)
    moved = np.zeros_like(place)
    for side, times in ((metal, wider), (~metal, 1.0)):
        if weight[side].sum() > 0:
            moved[side] = climb(place[side], weight[side], times * width) - place[side]
    whole = weight.sum()
    if whole == 0:
        return 0.0
    moved -= (weight[:, None] * moved).sum(axis=0) / whole  # lit paint outweighs shaded: colours would brighten
    color = (np.exp(place + moved) - LOG_FLOOR).clip(NARROW_MARGIN, BRIGHTEST)
    maps.parameter[:, :3] = logit(torch.from_numpy(color), NARROW_MARGIN).to(maps.parameter)
    return float((weight * np.abs(moved).mean(axis=1)).sum() / whole)


def climb(place: np.ndarray, weight: np.ndarray, width: float) -> np.ndarray:
    """The modes [T, 3] that each `place` [T, 3] climbs to, of the density of all with Gaussians of `width`.

    place in the logarithm of base colour, weight [T] at least 0 and not all 0. The density is that of a grid, and
    texels of one cell climb together: an error of some tenths of the width.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    low, high = place.min(axis=0) - 4 * width, place.max(axis=0) + 4 * width
    cell = max(width / FINE, float((high - low).max()) / (LONGEST - 1))
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)
    nearest = np.round((place - low) / cell).astype(np.int64)
    flat = np.ravel_multi_index(tuple(nearest.T), shape)
    count = np.bincount(flat, weights=weight, minlength=int(np.prod(shape))).reshape(shape)
    density = gaussian_filter(count, width / cell, mode="constant", truncate=4.0)
    slopes = np.gradient(np.log(density + 1e-12 * density.max()))
    taken, of = np.unique(flat, return_inverse=True)
    at = np.stack(np.unravel_index(taken, shape)).astype(float)
    for _ in range(CLIMB):  # a mean shift is width^2 times the slope of the density's logarithm
        slope = np.stack([map_coordinates(axis, at, order=1, mode="nearest") for axis in slopes])
        at += (width / cell) ** 2 * slope
    return (low + cell * at.T)[of]


def _moments(settings: DecompositionSettings) -> list[int]:
    """The steps before which colours gather."""
    if not settings.palette_width or settings.keep_light:
        return []
    known = metal.WHEN if metal.agrees(settings) else 0.0
    return [
        round(share * settings.iterations)
        for share in WHEN
        if share >= known and _reach(settings, share + WAIT) >= REACH
    ]


def _reach(settings: DecompositionSettings, share: float) -> float:
    """How far a texel gets that moves to one side from this share of the steps on: the sum of its rates."""
    rate, decay = learning_rates(settings)[0] * settings.iterations, settings.rate_decay
    return rate * ((1 - share) if decay == 1 else (decay**share - decay) / -math.log(decay))
