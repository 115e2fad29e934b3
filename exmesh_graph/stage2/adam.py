"""Adam (Kingma and Ba 2015) for the two parameter tables of Stage II.

torch.optim.Adam does the same; constructing it imports torch's compiler (over a second on a laptop), as long as forty
steps of this fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch


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
