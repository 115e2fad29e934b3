"""Adam (Kingma and Ba 2015) as the solvers use it, learning rates over time, and the order of the views.

torch.optim.Adam does the same as the plain form; constructing it imports torch's compiler (over a second on a laptop),
as long as forty steps of a fit. The moments are plain tensors, so that they travel with a state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

EPSILON = 1e-15
"""Far below any gradient of a mean over an image; it only keeps 0 / 0 from happening."""


@torch.no_grad()
def adam_step(
    values: torch.Tensor,
    gradient: torch.Tensor,
    first: torch.Tensor,
    second: torch.Tensor,
    step: int,
    rate: float,
    *,
    betas: tuple[float, float] = (0.9, 0.99),
    epsilon: float = EPSILON,
    uniform: bool = False,
    torch_rounding: bool = False,
) -> None:
    """Move `values` one step of bias-corrected Adam, and update both moments: in place.

    values, gradient, first   of one shape
    second    of that shape; or [V] for values [V, C]: the mean of a row's |g|^2. Sharing it over x, y, z makes the step
              of a vertex turn with the object, and points it along the gradient.
    step      counts from 1
    rate      length of a step under a steady gradient, in units of the values
    epsilon   the gradient below which steps shorten
    uniform   every row is divided by the largest of the second moments (AdamUniform of "Large Steps")
    torch_rounding  sqrt(v) / sqrt(1 - b2^t), as torch.optim.Adam rounds it, in place of sqrt(v / (1 - b2^t))
    """
    b1, b2 = betas
    first.lerp_(gradient, 1 - b1)
    if second.ndim < values.ndim:
        second.lerp_(gradient.square().sum(1), 1 - b2)
    else:
        second.mul_(b2).addcmul_(gradient, gradient, value=1 - b2)
    known = second.amax().expand_as(second) if uniform and len(second) else second
    if torch_rounding:
        scale = (known.sqrt() / (1 - b2**step) ** 0.5).add_(epsilon)
    else:
        scale = (known / (1 - b2**step)).sqrt_().add_(epsilon)
    scale = scale[:, None] if second.ndim < values.ndim else scale
    values.addcdiv_(first, scale, value=-rate / (1 - b1**step))


class Adam:
    """`adam_step` over leaf tensors, each with its own learning rate."""

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

    def step(self, scale: float = 1.0) -> None:
        """One update with all rates multiplied by `scale`; consumes the gradients."""
        self.steps += 1
        for parameter, rate, m, v in zip(self.parameters, self.rates, self.first, self.second, strict=True):
            if parameter.grad is not None:
                gradient, parameter.grad = parameter.grad, None
                adam_step(
                    parameter, gradient, m, v, self.steps, scale * rate, betas=self.betas, epsilon=self.eps,
                    torch_rounding=True,
                )  # fmt: skip


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
