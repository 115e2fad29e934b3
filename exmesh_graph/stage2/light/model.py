"""What a light model is to the fit: from maps and environment to the radiance of a view's pixels.

Two of them: `precomputed.PrecomputedLight` (transport traced once, no noise) and `sampled.SampledLight` (the paper's
Monte Carlo light).
A fit calls, in this order:

    texels                once
    view                  whenever a view's buffer is made: once, or again where memory is short (stage2.gbuffer)
    start                 once, before the first step of a fit that is not resumed
    prepare, radiance     every step: what holds for all pixels under the current maps and environment; then one view
    measure               now and then (DecompositionSettings.corrections): rays that no single step could afford
    state, restore        for checkpoints: everything that start, prepare and measure changed
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import torch

from exmesh_graph.stage2.gbuffer import ViewBuffer, ViewLight
from exmesh_graph.stage2.maps import Appearance, Material, MaterialMaps


class LightModel(ViewLight, Protocol):
    """Direct and indirect light of a frozen carrier, differentiable in maps and environment.

    `prepared` is whatever `prepare` returned for the step; `buffer.light` is whatever `view` returned for the buffer.
    """

    def start(self, maps: MaterialMaps, environment: torch.Tensor, buffers: Iterable[ViewBuffer]) -> None:
        """Whatever must be measured before the first step, under `environment` [H, W, 3]."""

    def prepare(self, appearance: Appearance) -> Any:
        """What all pixels share under the current maps and environment."""

    def radiance(self, buffer: ViewBuffer, material: Material, prepared: Any) -> torch.Tensor:
        """Radiance [N, 3] that the view's pixels send to the camera."""

    def measure(self, appearance: Appearance, buffers: Iterable[ViewBuffer], generator: torch.Generator) -> None:
        """Measure again, under the current maps and environment, whatever steps only approximate. No gradients."""

    def state(self, buffers: Iterable[ViewBuffer]) -> dict[str, Any]:
        """What `start`, `prepare` and `measure` changed, as types.state can store it."""

    def restore(self, buffers: Iterable[ViewBuffer], kept: Mapping[str, Any]) -> None:
        """Go on from `state`."""
