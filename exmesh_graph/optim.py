"""Adam (Kingma and Ba 2015) as the solvers use it, learning rates over time, and the order of the views.

torch.optim.Adam does the same as the plain form; constructing it imports torch's compiler (over a second on a laptop),
as long as forty steps of a fit. The moments are plain tensors, so that they travel with a state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

VERTEX_BETAS = (0.9, 0.99)
TEXTURE_BETAS = (0.9, 0.99)
EPSILON = 1e-15
"""Far below any gradient of a mean over an image; it only keeps 0 / 0 from happening."""


@torch.no_grad()
def vertex_step(
    vertices: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    betas: tuple[float, float] = VERTEX_BETAS,
    *,
    uniform: bool = False,
) -> None:
    """Adam on vertices [V, 3] with one second moment per vertex [V], the mean of |g|^2: in place.

    Sharing it over x, y, z makes the step turn with the object, and points it along the gradient. `step` counts from
    1; `rate` is the length of a step under a steady gradient, in world units. `uniform`: every vertex is divided by
    the largest of the second moments (AdamUniform of "Large Steps").
    """
    b1, b2 = betas
    first.lerp_(gradient, 1 - b1)
    second.lerp_(gradient.square().sum(1), 1 - b2)
    known = second.amax().expand_as(second) if uniform and len(second) else second
    scale = (known / (1 - b2**step)).sqrt_().add_(EPSILON)
    vertices.addcdiv_(first, scale[:, None], value=-rate / (1 - b1**step))


@torch.no_grad()
def texture_step(
    texture: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    betas: tuple[float, float] = TEXTURE_BETAS,
    epsilon: float = EPSILON,
) -> None:
    """Adam on texels, then projection to [0, 1]: in place. Clamping after the step leaves no dead gradient.

    `epsilon` is the gradient below which steps shorten: a texel that bilinear lookups merely graze would otherwise
    run about at full speed on a trace of a gradient, and stand out as a speck of wrong colour.
    """
    b1, b2 = betas
    first.lerp_(gradient, 1 - b1)
    second.mul_(b2).addcmul_(gradient, gradient, value=1 - b2)
    scale = (second / (1 - b2**step)).sqrt_().add_(epsilon)
    texture.addcdiv_(first, scale, value=-rate / (1 - b1**step)).clamp_(0, 1)


def vertex_areas(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """A third of the area of the faces around each vertex [V], held above 1e-3 of the mean.

    A vertex's gradient is proportional to the surface it carries. Adam's moments of gradient / area therefore mean
    the same before and after a split, where those of the raw gradient would be stale for 1 / (1 - beta) iterations
    and the steps too short by the factor that areas fell.
    """
    corners = vertices.double()[faces.long()]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1) / 6
    total = area.new_zeros(len(vertices))
    for k in range(3):
        total.index_add_(0, faces[:, k].long(), area)
    floor = 1e-3 * total.mean() + torch.finfo(total.dtype).tiny
    return total.clamp(min=floor).to(vertices.dtype)


class Adam:
    """Bias-corrected Adam over leaf tensors, each with its own learning rate."""

    def __init__(
        self,
        parameters: list[torch.Tensor],
        rates: list[float],
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        self.parameters, self.rates, self.betas, self.eps = parameters, rates, betas, eps
        self.first = [torch.zeros_like(p) for p in parameters]
        self.second = [torch.zeros_like(p) for p in parameters]
        self.steps = 0

    def state(self) -> dict[str, Any]:
        """Parameters and moments (the tensors themselves), and the number of steps."""
        return {"parameters": self.parameters, "first": self.first, "second": self.second, "steps": self.steps}

    @torch.no_grad()
    def restore(self, kept: Mapping[str, Any]) -> None:
        """Take over the values of `state`."""
        for name in ("parameters", "first", "second"):
            for tensor, value in zip(getattr(self, name), kept[name], strict=True):
                tensor.copy_(value)
        self.steps = kept["steps"]

    @torch.no_grad()
    def step(self, scale: float = 1.0) -> None:
        """One update with all rates multiplied by `scale`; consumes the gradients."""
        self.steps += 1
        b1, b2 = self.betas
        correction = (1 - b2**self.steps) ** 0.5
        for parameter, rate, m, v in zip(self.parameters, self.rates, self.first, self.second, strict=True):
            gradient = parameter.grad
            if gradient is None:
                continue
            m.lerp_(gradient, 1 - b1)
            v.mul_(b2).addcmul_(gradient, gradient, value=1 - b2)
            denominator = (v.sqrt() / correction).add_(self.eps)
            parameter.addcdiv_(m, denominator, value=-scale * rate / (1 - b1**self.steps))
            parameter.grad = None


def decayed(start: float, ratio: float, iteration: int, total: int) -> float:
    """start * ratio^(iteration / total), held at start * ratio afterwards; `total` <= 0 means no decay."""
    if total <= 0:
        return start
    return start * ratio ** min(iteration / total, 1.0)


def view_at(iteration: int, views: int, seed: int) -> int:
    """The view of an iteration: each epoch of `views` iterations is a permutation of its own, seeded by (seed, epoch).

    A function of its arguments alone, so that a run cut into several calls visits the views as one call does.
    """
    epoch, place = divmod(iteration, views)
    return int(np.random.default_rng([seed, epoch]).permutation(views)[place])
