"""The interface of an appearance model, and the paper's own: the UV texture.

A model holds one tensor of values that the loss has a gradient for, and Adam's two moments of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import torch

from exmesh_graph.raster import shade
from exmesh_graph.stage1.optimiser import texture_step
from exmesh_graph.types import Carrier, Stage1State

if TYPE_CHECKING:
    from exmesh_graph.stage1.render import Surface

GRAZED = 0.05
"""A texel whose gradient stays below this share of a full pixel's is only grazed by lookups, not seen."""


class Moments(NamedTuple):
    """Adam's moments, of the shape of the values."""

    first: torch.Tensor
    second: torch.Tensor


class Model:
    """Colours of a surface: `values` (a leaf with gradient once a fit runs) and their moments.

    Colours are sRGB-encoded; models whose values are colours are held in [0, 1] after each step.
    """

    kind: ClassVar[str]
    colours: ClassVar[bool] = True

    def __init__(self, values: torch.Tensor, moments: Moments | None = None) -> None:
        self.values = values
        self.moments = moments or Moments(torch.zeros_like(values), torch.zeros_like(values))
        self.touched = torch.zeros(values.shape[:-1], dtype=torch.bool, device=values.device)

    def shade(self, surface: Surface, projected: torch.Tensor, face_id: torch.Tensor) -> torch.Tensor:
        """Colour [H, W, 3] at every pixel, 0 on the background (face_id [H, W] = -1).

        Differentiable in `values`, and in `projected` and `surface.vertices` where the colour depends on the place
        on the surface.
        """
        raise NotImplementedError

    def step(self, gradient: torch.Tensor, count: int, rate: float, pixel: float) -> None:
        """Adam step number `count`, in place; `rate` in colour units, `pixel` the gradient of one pixel's L1."""
        self.touched |= (gradient.abs() > GRAZED * pixel).any(dim=-1)
        texture_step(self.values, gradient, *self.moments, count, rate, epsilon=GRAZED * pixel)

    def changing(self) -> dict[str, torch.Tensor]:
        """The tensors that `step` changes, in place."""
        return {"values": self.values, "m": self.moments.first, "v": self.moments.second, "touched": self.touched}

    def arrays(self) -> dict[str, np.ndarray]:
        """`Stage1State.model` after a fit."""
        named = {"values": self.values.detach(), "m": self.moments.first, "v": self.moments.second}
        return {name: tensor.cpu().numpy() for name, tensor in named.items()}

    def fields(self, state: Stage1State, fill: bool) -> dict[str, Any]:
        """What the fit changed, as fields of the state: the model, and the texture that shows it.

        `state` has the fitted vertices already. `fill` replaces values that no view touched by their neighbours'.
        """
        raise NotImplementedError


class UVTexture(Model):
    """The paper's T_rgb: texels [R, R, 3] read bilinearly."""

    kind = "uv_texture"

    def shade(self, surface: Surface, projected: torch.Tensor, face_id: torch.Tensor) -> torch.Tensor:
        return shade(projected, surface.faces, surface.uvs, surface.uv_faces, self.values, face_id)

    def fields(self, state: Stage1State, fill: bool) -> dict[str, Any]:
        from exmesh_graph.stage1.init import fill_unseen

        texture = self.values.detach()
        if fill:
            texture = fill_unseen(texture, self.touched)
        first, second = (moment.cpu().numpy() for moment in self.moments)
        return {"texture": texture.cpu().numpy(), "texture_m": first, "texture_v": second}


def model_of(carrier: Carrier, device: torch.device | str = "cpu") -> Model:
    """The appearance of a carrier: the model of a Stage I state, the texture of any other."""

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.asarray(array, np.float32), device=device)

    texture = tensor(carrier.texture)
    if not isinstance(carrier, Stage1State):
        return UVTexture(texture)
    return UVTexture(texture, Moments(tensor(carrier.texture_m), tensor(carrier.texture_v)))
