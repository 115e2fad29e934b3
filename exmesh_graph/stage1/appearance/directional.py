"""Colour that changes with the direction of view: the texture, and on every vertex a small residual beside it.

    colour(x, d) = texture(x) + sum_k r_k (Y_k(d) - m_k)        of the vertices, interpolated over the face

Y are the real spherical harmonics of the first order, or of the first two, scaled so that the first three are the
direction's x, y and z; d points from the vertex to the camera; m is the mean of Y over the views that show the vertex.
So the residual has no part in the mean of what the views see: the texture holds that, and it stays when the residual is
dropped. Of a mirrored direction in place of d the harmonics would span the same functions, for a reflection turns those
of an order into one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from exmesh_graph.gpu.cores import shared
from exmesh_graph.optim import adam_step
from exmesh_graph.stage1.appearance.colours import UVTexture
from exmesh_graph.stage1.appearance.model import GRAZED, Moments, Surface
from exmesh_graph.stage1.appearance.tints import fused_tints, step_residual
from exmesh_graph.stage1.vertices import serves
from exmesh_graph.targets import Targets

COUNTS = {1: 3, 2: 8}
"""Harmonics up to an order, without the constant."""


class Directional(UVTexture):
    """`values` are texels [R, R, 3]; `residual` [V, 3 K] has three channels for each harmonic; `mean` is [V, K].

    shrinkage  weight of the residual's mean square over the vertices, times the share of the picture that shows them
    rate       step of the residual over the step of a texel
    Adam has one second moment per vertex: its steps turn with the object.
    """

    def __init__(
        self,
        values: torch.Tensor,
        moments: Moments | None,
        residual: torch.Tensor,
        residual_moments: Moments,
        mean: torch.Tensor,
        *,
        shrinkage: float,
        rate: float,
    ) -> None:
        super().__init__(values, moments)
        self.residual, self.residual_moments, self.mean = residual, residual_moments, mean
        self.shrinkage, self.rate = shrinkage, rate
        self.share = 0.0

    def leaves(self) -> list[torch.Tensor]:
        return [self.values, self.residual]

    @torch.no_grad()
    def prepare(self, surface: Surface, targets: Targets) -> None:
        """Take the means over the views that show a vertex's faces; a vertex that none shows keeps its own."""
        vertices, count = surface.vertices.detach(), self.mean.shape[1]
        shown = targets.shown(vertices, surface.faces)

        @torch.no_grad()  # a thread's own switch
        def values(visible: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
            return visible[:, None] * harmonics(directions(vertices, pose), count)

        total = torch.zeros_like(self.mean)
        for one in shared(values, shown.vertices, targets.world_to_camera):
            total += one
        seen = shown.vertices.sum(dim=0)[:, None]
        self.mean = torch.where(seen > 0, total / seen.clamp(min=1), self.mean)
        self.share = shown.pixels / (max(1, len(vertices)) * len(targets) * targets.height * targets.width)

    def tints(self, vertices: torch.Tensor, world_to_camera: torch.Tensor) -> torch.Tensor:
        if serves(vertices, self.residual, self.mean):
            x, y, z = camera_place(world_to_camera).tolist()
            return fused_tints(vertices, self.residual, self.mean, (x, y, z))
        return plain_tints(vertices, self.residual, self.mean, world_to_camera)

    @torch.no_grad()
    def step(self, gradients: Sequence[torch.Tensor], count: int, rate: float, pixel: float) -> bool:
        finite = super().step(gradients, count, rate, pixel)
        pull, rate, epsilon = 2 * self.shrinkage * self.share, self.rate * rate, GRAZED * pixel
        moments = self.residual_moments
        if serves(self.residual, gradients[1], *moments):
            return finite & step_residual(self.residual, gradients[1], moments, count, rate, pull=pull, epsilon=epsilon)
        pulled = gradients[1] + pull * self.residual
        adam_step(self.residual, pulled, *moments, count, rate, epsilon=epsilon)
        return finite and bool(torch.isfinite(pulled.sum()))

    def changing(self) -> dict[str, torch.Tensor]:
        first, second = self.residual_moments
        return {**super().changing(), "residual": self.residual, "residual_m": first, "residual_v": second}

    def fields(self, surface: Surface, size: int, fill: bool) -> dict[str, Any]:
        first, second = self.residual_moments
        named = {"values": self.residual.detach(), "m": first, "v": second, "mean": self.mean}
        model = {name: tensor.cpu().numpy() for name, tensor in named.items()}
        settings = np.array([self.shrinkage, self.rate], np.float32)
        return {**super().fields(surface, size, fill), "model": {**model, "settings": settings}}


def plain_tints(
    vertices: torch.Tensor, residual: torch.Tensor, mean: torch.Tensor, world_to_camera: torch.Tensor
) -> torch.Tensor:
    """Tints [V, 3] of vertices [V, 3] by residual [V, 3 K] and mean [V, K], in torch."""
    count = mean.shape[1]
    basis = harmonics(directions(vertices, world_to_camera), count) - mean
    return (basis[:, None] @ residual.view(-1, count, 3))[:, 0]


def camera_place(world_to_camera: torch.Tensor) -> torch.Tensor:
    """Where a camera [4, 4] stands, [3]."""
    return -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]


def directions(vertices: torch.Tensor, world_to_camera: torch.Tensor) -> torch.Tensor:
    """Unit vectors [V, 3] from the vertices to the camera."""
    return torch.nn.functional.normalize(camera_place(world_to_camera.to(vertices)) - vertices, dim=1)


def harmonics(direction: torch.Tensor, count: int) -> torch.Tensor:
    """[V, count] of unit directions [V, 3], `count` as in `COUNTS`; each has a mean square of 1 / 3 over the sphere."""
    if count == COUNTS[1]:
        return direction
    x, y, z = direction.unbind(1)
    second = [x * y, y * z, (3 * z * z - 1) / 12**0.5, x * z, (x * x - y * y) / 2]
    return torch.cat([direction, 5**0.5 * torch.stack(second, dim=1)], dim=1)
