"""Roughness where no highlight tells it: drawn to that of texels of like colour, as far as the pictures are silent.

A texel's roughness r is told by h = sum over its pixels of (d log(1 + L) / d r)^2: its variance is v = C s^2 / h, s^2
the mean squared residual of a pixel. Texels of like base colour (and metallic) are taken for one material whose
roughness spreads about a mean m by t^2, both found from the texels themselves (empirical Bayes; Efron and Morris 1975).
What is kept is the mean of r and m weighted by 1 / v and 1 / t^2: where roughness varies within a colour, t is large
and little moves; where it does not, what no highlight tells takes the value of what one does.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch

from exmesh_graph.stage2.maps import Material

if TYPE_CHECKING:
    from exmesh_graph.stage2.decomposition import Decomposition

#: Half the difference of roughness that slopes are measured over, and the views looked at, at most.
STEP, VIEWS = 0.05, 24
#: Cells of the grid of colours: so much of the logarithm of base colour + DARK, and of metallic.
CELL, DARK, METAL_CELL = 0.2, 0.02, 0.25
#: Spread within a material that is taken for none.
LEAST = 1e-6
ROUNDS = 3


@torch.no_grad()
def settle_roughness(model: Decomposition, doubt: float) -> str:
    """Draw the roughness of `model`'s texels together, C = `doubt`; says what was done."""
    values = model.maps.values()
    evidence, residual = told(model)
    alike = values[:, :3] if not model.settings.metallic else torch.cat([values[:, :3], values[:, 4:5]], 1)
    variance = doubt * residual / evidence.clamp_min(1e-9 * max(residual, 1e-12))
    fitted = values[:, 3].double().cpu().numpy()
    roughness, spread = drawn_together(fitted, variance.cpu().numpy(), alike.double().cpu().numpy())
    model.maps.parameter[:, 3] = model.maps.of_roughness(torch.from_numpy(roughness).to(values))
    moved = float(np.abs(roughness - fitted).mean())
    return f"roughness varies by {spread:.3f} within a colour; drawn together by {moved:.3f} on average"


@torch.no_grad()
def told(model: Decomposition) -> tuple[torch.Tensor, float]:
    """h float64 [T] of each texel's roughness, over all views, and s^2, both of the logarithm of 1 + radiance."""
    texels, device = len(model.maps.texels), model.maps.texels.device
    evidence = torch.zeros(texels, dtype=torch.float64, device=device)
    usable = [k for k in range(len(model.buffers)) if model.buffers.pixels[k] and k not in model.buffers.faults]
    chosen = usable[:: max(1, math.ceil(len(usable) / VIEWS))]
    prepared = model.prepare(model.settings.indirect_weight, model.settings.iterations)
    low = model.settings.roughness_min
    wrong, counted = 0.0, 0
    for number in chosen:
        buffer = model.buffers[number]
        predicted, material = model.shade(buffer, prepared)
        ends = [(material.roughness + side * STEP).clamp(low, 1) for side in (-1, 1)]
        radiance, lit = [], model.lit(buffer, prepared)
        for roughness in ends:
            table = material.table.clone()
            table[:, 3] = roughness
            other = Material(table, material.has_metallic, material.has_normal)
            radiance.append(model.light.radiance(buffer, other, lit))
        slope = (radiance[1] - radiance[0]) / (ends[1] - ends[0])[:, None] / (1 + predicted.clamp_min(0))
        slope = torch.where(buffer.clipped, torch.zeros_like(slope), slope).square().sum(1)
        share = (buffer.texel_weight * slope[:, None]).double()
        evidence.index_add_(0, buffer.texel.reshape(-1).long(), share.reshape(-1))
        residual = torch.log1p(predicted.clamp_min(0)) - torch.log1p(buffer.target.clamp_min(0))
        residual = residual[~buffer.clipped]
        wrong, counted = wrong + float(residual.double().square().sum()), counted + len(residual)
    return evidence * (len(usable) / max(len(chosen), 1)), wrong / max(counted, 1)


def drawn_together(roughness: np.ndarray, variance: np.ndarray, alike: np.ndarray) -> tuple[np.ndarray, float]:
    """`roughness` [T] known to `variance` [T], drawn to the mean of what is `alike` [T, 3 or 4] (linear base colour,
    metallic): the new roughness and its spread t within a material."""
    place = colour_cells(alike[:, :3], CELL)
    if alike.shape[1] > 3:
        place = np.concatenate([place, alike[:, 3:] / METAL_CELL], axis=1)
    spread = 0.01
    for _ in range(ROUNDS):
        mean = means_about(place, roughness, 1 / (variance + spread))
        spread = _spread(roughness - mean, variance)
    weight = variance / (variance + spread)
    return roughness + weight * (mean - roughness), math.sqrt(spread)


def colour_cells(color: np.ndarray, cell: float) -> np.ndarray:
    """Where linear colours [T, 3] stand among others for `means_about`, `cell` of their logarithm to a cell."""
    return np.log(color + DARK) / cell


def means_about(place: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted mean of `values` [T] about each `place` [T, D], by a Gaussian of one cell: a grid, smoothed, read."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    low = np.floor(place.min(axis=0))
    shape = tuple((np.ceil(place.max(axis=0)) - low).astype(int) + 1)
    nearest = np.round(place - low).astype(np.int64).T
    flat = np.ravel_multi_index(tuple(nearest), shape)
    sums = [np.bincount(flat, weights=w, minlength=int(np.prod(shape))) for w in (weight * values, weight)]
    total, count = (gaussian_filter(s.reshape(shape), 1.0, mode="constant", truncate=3.0) for s in sums)
    at = (place - low).T
    above, below = (map_coordinates(grid, at, order=1, mode="nearest") for grid in (total, count))
    return np.where(below > 0, above / np.maximum(below, 1e-300), values)


def _spread(apart: np.ndarray, variance: np.ndarray) -> float:
    """t^2 by which values lie `apart` from their mean, beyond their `variance`: moments, weighted as a likelihood's."""
    spread = float(np.mean(apart**2))
    for _ in range(50):
        weight = 1 / (spread + variance) ** 2
        spread = max(LEAST, float((weight * (apart**2 - variance)).sum() / weight.sum()))
    return spread
