"""One exposure per training view, for photographs whose brightness wanders.

A view's gain is the factor that brings the rendering to its photograph: where it is visited, its logarithm follows the
median over the view's pixels of log(photograph / rendering), which no highlight moves. Gains enter divided by their
median, so that together they cannot brighten the light and one view's wrong exposure stays its own. They rest for the
first part of the fit: before the sky has its shape, views that look at the bright side would be taken for overexposed
ones.
"""

from __future__ import annotations

import math

import torch

from exmesh_graph.stage2.gbuffer import ViewBuffer

RATE = 0.3
#: Share of the fit's steps during which the gains stay at 1.
REST = 0.1
LARGEST = math.log(4.0)
#: Pixels darker than this tell more of noise than of exposure.
DARK = 0.01


class Exposure:
    """Log-gains float32 [N] of N views; `logs` is replaced at each change."""

    def __init__(self, views: int, device: torch.device | str = "cpu") -> None:
        self.logs = torch.zeros(views, device=device)

    def gain(self, number: int) -> torch.Tensor:
        """What to multiply the rendering of a view with."""
        return (self.logs[number] - self.logs.quantile(0.5)).exp()

    @torch.no_grad()
    def follow(self, buffer: ViewBuffer, predicted: torch.Tensor, progress: float) -> None:
        """Move the gain of a view whose rendering, gain included, is `predicted` [N, 3] at this share of the fit."""
        if progress < REST:
            return
        usable = (predicted > DARK) & (buffer.target > DARK) & ~buffer.clipped
        ratio = (buffer.target[usable] / predicted[usable]).log()
        if len(ratio):
            logs = self.logs.clone()
            logs[buffer.number] = (logs[buffer.number] + RATE * ratio.median()).clamp(-LARGEST, LARGEST)
            self.logs = logs
