"""A coloured surface, and the interface of what colours it: one tensor of values that a fit has a gradient for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from exmesh_graph.optim import Bounds, adam_step
from exmesh_graph.raster import EdgeTable
from exmesh_graph.targets import Targets

GRAZED = 0.05
"""A texel whose gradient stays below this share of a full pixel's is only grazed by lookups, not seen."""


class Moments(NamedTuple):
    """Adam's moments, of the shape of the values."""

    first: torch.Tensor
    second: torch.Tensor


class Surface(NamedTuple):
    """A mesh on the device: vertices [V, 3], faces and uv_faces int32 [F, 3], uvs [T, 2], and what colours it.

    `extent` is the diagonal of the bounding box when the surface was made.
    """

    vertices: torch.Tensor
    faces: torch.Tensor
    uvs: torch.Tensor
    uv_faces: torch.Tensor
    appearance: AppearanceModel
    edges: EdgeTable
    extent: float


class AppearanceModel:
    """Colours of a surface: `values` (a leaf with gradient once a fit runs) and their moments.

    Colours are sRGB-encoded; values are colours and are held in [0, 1], unless a model says otherwise.
    """

    def __init__(self, values: torch.Tensor, moments: Moments | None = None) -> None:
        self.values = values
        self.moments = moments or Moments(torch.zeros_like(values), torch.zeros_like(values))
        self.touched = torch.zeros(values.shape[:-1], dtype=torch.bool, device=values.device)

    def leaves(self) -> list[torch.Tensor]:
        """The tensors that a fit has gradients for; `values` first."""
        return [self.values]

    def prepare(self, surface: Surface, targets: Targets) -> None:
        """Take from the surface and all views what a fit of them needs; before the first step."""

    def tints(self, vertices: torch.Tensor, world_to_camera: torch.Tensor) -> torch.Tensor | None:
        """Colours [V, 3] of the vertices in a view that are added, interpolated over the faces, to those of `shade`."""
        return None

    def shade(self, surface: Surface, projected: torch.Tensor, face_id: torch.Tensor) -> torch.Tensor:
        """Colour [H, W, 3] at every pixel, 0 on the background (face_id [H, W] = -1).

        Differentiable in `values`, and in `projected` and `surface.vertices` where the colour depends on the place
        on the surface.
        """
        raise NotImplementedError

    @torch.no_grad()
    def step(self, gradients: Sequence[torch.Tensor], count: int, rate: float, pixel: float) -> bool:
        """Adam step number `count` of the leaves, in place: `rate` in colour units, `pixel` one pixel's L1's gradient.
        Returns whether all gradients were finite.

        A texel that bilinear lookups merely graze would run about at full speed on a trace of a gradient, and stand
        out as a speck of wrong colour: steps shorten below `GRAZED`. Colours are held in [0, 1] after the step, which
        leaves no dead gradient.
        """
        grazed = GRAZED * pixel
        bounds = Bounds(self.touched, grazed)
        return adam_step(
            self.values, gradients[0], *self.moments, count, rate, epsilon=grazed, bounds=bounds, check=True
        )

    def changing(self) -> dict[str, torch.Tensor]:
        """The tensors that `step` changes, in place."""
        return {"values": self.values, "m": self.moments.first, "v": self.moments.second, "touched": self.touched}

    def fields(self, surface: Surface, size: int, fill: bool) -> dict[str, Any]:
        """What a fit changed, as fields of the Stage1State: the model, and the texture of `size` texels that shows it.

        `fill` replaces texels that no view touched by their neighbours.
        """
        raise NotImplementedError

    def arrays(self) -> dict[str, np.ndarray]:
        """`values`, `m` and `v` as arrays."""
        named = {"values": self.values.detach(), "m": self.moments.first, "v": self.moments.second}
        return {name: tensor.cpu().numpy() for name, tensor in named.items()}
