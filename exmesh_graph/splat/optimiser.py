"""Adam over Gaussians: rows that a view does not see stand still, each row counts its own steps."""

from __future__ import annotations

import torch

from exmesh_graph.gpu.warp_runtime import launch
from exmesh_graph.optim import EPSILON
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.runtime import kernels


class GaussianAdam:
    """Adam (beta 0.9, 0.999) on all parameters, in place, one pass over memory.

    A Gaussian outside the view has no gradient; plain Adam would move it on by its momentum and let its variance fade.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self.gaussians = gaussians
        self.m = gaussians.map(torch.zeros_like)
        self.v = gaussians.map(torch.zeros_like)
        self.steps = torch.zeros_like(gaussians.opacities)

    def step(self, gradients: dict[str, torch.Tensor], seen: torch.Tensor, rates: dict[str, float]) -> None:
        """One step of the rows `seen` bool [G]; `rates` by parameter, "sh_rest" for the harmonics above degree 0."""
        self.steps += seen
        count = len(self.gaussians)
        for name, value in self.gaussians.tensors().items():
            if count == 0:
                continue
            flat = [t.view(count, -1) for t in (value, gradients[name].contiguous(), getattr(self.m, name),
                                                getattr(self.v, name))]  # fmt: skip
            rest = rates["sh_rest"] if name == "sh" else rates[name]
            launch(kernels("adam", value.dtype).adam, count, *flat, self.steps, seen, rates[name], rest, EPSILON)

    def rows(self, kept: torch.Tensor, added: Gaussians) -> None:
        """Keep the rows `kept` and append new Gaussians, whose moments begin at zero."""
        self.gaussians = _joined(self.gaussians.map(lambda t: t[kept]), added)
        fresh = added.map(torch.zeros_like)
        self.m, self.v = (_joined(moment.map(lambda t: t[kept]), fresh) for moment in (self.m, self.v))
        self.steps = torch.cat([self.steps[kept], torch.zeros_like(added.opacities)])

    def forget(self, name: str) -> None:
        """Moments of one parameter back to zero, after it was set from outside."""
        getattr(self.m, name).zero_()
        getattr(self.v, name).zero_()

    def state(self) -> dict[str, dict[str, torch.Tensor] | torch.Tensor]:
        """All that steps change."""
        parts = {"values": self.gaussians, "m": self.m, "v": self.v}
        return {**{name: part.tensors() for name, part in parts.items()}, "steps": self.steps}

    def restore(self, state: dict) -> None:
        """Back to what `state` gave, of however many Gaussians."""
        device = self.steps.device
        self.gaussians, self.m, self.v = (
            Gaussians(**{name: t.to(device) for name, t in state[part].items()}) for part in ("values", "m", "v")
        )
        self.steps = state["steps"].to(device)


def _joined(a: Gaussians, b: Gaussians) -> Gaussians:
    return Gaussians(**{name: torch.cat([t, getattr(b, name)]) for name, t in a.tensors().items()})
