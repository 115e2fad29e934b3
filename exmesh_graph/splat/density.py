"""Where Gaussians are added and removed (adaptive density control, with an absolute-gradient rule)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch

from exmesh_graph.splat.gaussians import Gaussians, rotation_matrices
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.render import Render

if TYPE_CHECKING:
    from exmesh_graph.splat.settings import PgsrSettings

_LARGE = 0.01  # world units: larger ones are split, smaller ones doubled
_TOO_LARGE = 0.2
_SHRINK = 1.6


class Density:
    """What views said of each Gaussian since the last round: gradient lengths on screen, and whether it was seen."""

    def __init__(self, count: int, like: torch.Tensor) -> None:
        self.sums = like.new_zeros((count, 2))
        self.views = like.new_zeros(count)
        self.weight = like.new_zeros(count)

    def add(self, drawing: Render, width: int) -> None:
        """After the backward pass of a view of this width in pixels."""
        drawn = drawing.drawn
        self.sums += drawn.gradient * (width / 2)
        self.views += drawn.seen
        self.weight = torch.maximum(self.weight, drawn.weight)

    def state(self) -> dict[str, torch.Tensor]:
        return {"sums": self.sums, "views": self.views, "weight": self.weight}

    def restore(self, state: dict[str, torch.Tensor]) -> None:
        for name, value in state.items():
            setattr(self, name, value.to(self.sums.device))


def control(adam: GaussianAdam, density: Density, settings: PgsrSettings, generator: torch.Generator) -> dict[str, int]:
    """Double, split and prune; returns the counts. Afterwards `density` is spent: begin a new one.

    Small Gaussians of large gradient are doubled, large ones split in two drawn from them at 1 / 1.6 of their size; the
    absolute gradient splits those in whose pixels opposite pulls cancel. Pruned: fainter than `min_opacity`, longer
    than a fifth of the world's radius, and what no view of the round saw. At `max_gaussians` the largest gradients win.
    """
    gaussians = adam.gaussians
    mean = density.sums / density.views.clamp(min=1)[:, None]
    size = gaussians.scales.amax(dim=1).exp()
    dead = torch.sigmoid(gaussians.opacities) < settings.min_opacity
    dead |= size > _TOO_LARGE
    dead |= density.weight <= 0
    score = torch.maximum(mean[:, 0] / settings.densify, torch.where(size > _LARGE, mean[:, 1], 0.0)
                          / settings.densify_absolute)  # fmt: skip
    wanted = torch.nonzero((score >= 1) & ~dead)[:, 0]
    room = max(0, settings.max_gaussians - int((~dead).sum()))
    if len(wanted) > room:
        wanted = wanted[torch.argsort(score[wanted], descending=True, stable=True)[:room]].sort().values
    split = wanted[size[wanted] > _LARGE]
    double = wanted[size[wanted] <= _LARGE]
    dead[split] = True
    added = [gaussians.map(lambda t: t[double]), *(_halves(gaussians, split, generator) for _ in range(2))]
    new = Gaussians(**{name: torch.cat([part.tensors()[name] for part in added]) for name in gaussians.tensors()})
    counts = {"pruned": int(dead.sum()) - len(split), "doubled": len(double), "split": len(split)}
    adam.rows(torch.nonzero(~dead)[:, 0], new)
    return counts


def _halves(gaussians: Gaussians, chosen: torch.Tensor, generator: torch.Generator) -> Gaussians:
    part = gaussians.map(lambda t: t[chosen])
    noise = torch.randn(part.scales.shape, generator=generator).to(part.scales)
    turned = rotation_matrices(part.rotations) @ (noise * part.scales.exp())[..., None]
    shrunk = part.scales - math.log(_SHRINK)
    return Gaussians(part.means + turned[..., 0], shrunk, part.rotations, part.opacities, part.sh)


def reset_opacity(adam: GaussianAdam, most: float = 0.01) -> None:
    """No Gaussian more opaque than `most`: what the photographs do not ask for again is pruned later."""
    limit = math.log(most / (1 - most))
    adam.gaussians.opacities.clamp_(max=limit)
    adam.forget("opacities")
