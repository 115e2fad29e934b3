"""Appearance as a function of the place in space: a coordinate network, which needs no atlas.

    x' = (x - centre) / radius,  features = x', sin(2^k pi x'), cos(2^k pi x') for k < frequencies
    colour = sigmoid(W3 relu(W2 relu(W1 features + b1) + b2) + b3)

(positional encoding: Mildenhall et al. 2020, eq. 4). Centre and radius are those of the start's bounding box, so that
nothing depends on the scene's scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from exmesh_graph.optim import adam_step
from exmesh_graph.stage1.appearance.colours import SurfaceModel
from exmesh_graph.stage1.appearance.model import Moments, Surface

RATE = 0.3
"""Step of a weight over the step of a colour."""


def layers(frequencies: int, width: int) -> list[tuple[int, int]]:
    """(outputs, inputs) of the three linear layers."""
    return [(width, 3 + 6 * frequencies), (width, width), (3, width)]


def weight_count(frequencies: int, width: int) -> int:
    """Length of the weight vector: for each layer the matrix, row by row, then its bias."""
    return sum(out * (into + 1) for out, into in layers(frequencies, width))


class Mlp(SurfaceModel):
    """`values` are the weights [P]; `box` is the centre and the radius of the encoding, [4]."""

    def __init__(
        self, values: torch.Tensor, moments: Moments | None, *, frequencies: int, width: int, box: torch.Tensor
    ) -> None:
        super().__init__(values, moments)
        self.frequencies, self.width, self.box = frequencies, width, box

    def at(self, surface: Surface, face: torch.Tensor, bary: torch.Tensor) -> torch.Tensor:
        corners = surface.vertices.index_select(0, surface.faces.long()[face].reshape(-1)).view(-1, 3, 3)
        return self.colour((bary[..., None] * corners).sum(1))

    def colour(self, points: torch.Tensor) -> torch.Tensor:
        """Colours [P, 3] of `points` [P, 3]; differentiable in both the points and the weights."""
        box = self.box.to(points)
        place = (points - box[:3]) / box[3]
        scaled = torch.cat([place * (math.pi * 2**k) for k in range(self.frequencies)], dim=1)
        features = torch.cat([place, scaled.sin(), scaled.cos()], dim=1)
        start = 0
        shapes = layers(self.frequencies, self.width)
        for index, (out, into) in enumerate(shapes):
            matrix = self.values[start : start + out * into].view(out, into)
            bias = self.values[start + out * into : start + out * (into + 1)]
            start += out * (into + 1)
            features = torch.addmm(bias, features, matrix.T)
            if index + 1 < len(shapes):
                features = features.relu()
        return features.sigmoid()

    def step(self, gradients: Sequence[torch.Tensor], count: int, rate: float, pixel: float) -> bool:
        return adam_step(self.values, gradients[0], *self.moments, count, RATE * rate, check=True)

    def arrays(self) -> dict[str, Any]:
        shape = np.array([self.frequencies, self.width], np.int32)
        return {**super().arrays(), "shape": shape, "box": self.box.cpu().numpy()}
