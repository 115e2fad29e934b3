"""Vector irradiance of a frozen mesh: how its irradiance changes when the shading normal turns.

    F(p) = sum_k V[p, k] L_k w_k        over the directions w_k above the point's horizon,  n . F = I_0

and the same over the blocked directions with what the mesh sends back along them (types.Transport's hits).
"""

from __future__ import annotations

import math

import numpy as np
import torch

from exmesh_graph.gpu.torch_setup import csr_tensor
from exmesh_graph.shading.lattice import locate
from exmesh_graph.shading.transport import LightTransport


class VectorTransport:
    """The three components of T (and of M, where it has bounces) of `operators`, before the cosine."""

    def __init__(self, operators: LightTransport) -> None:
        light, device = operators.light, operators.transfer.device
        directions = torch.from_numpy(light.directions).to(device)
        above = (torch.from_numpy(light.normals).to(device) @ directions.T > 0) & (operators.visible > 0)
        # [P, 3, K]: K directions times their axes
        self.transfer = (above[:, None] * directions.T[None]).to(directions).reshape(-1, len(directions))
        self.gather = [_component(operators, axis) for axis in range(3)] if operators.gather is not None else []

    def vector(
        self, radiance: torch.Tensor, sent: torch.Tensor | None = None, received: torch.Tensor | None = None
    ) -> torch.Tensor:
        """F [P, 9] (x, y, z of red, green, blue: [3, 3] flattened) of binned light `radiance` [K, 3].

        sent      diffuse radiance [P, 3] of the points, which adds the mesh's own light; it gets no gradient. The
                  light does.
        received  [P, 3], what to multiply the mesh's own light with where it arrives; None: nothing
        """
        direct = (self.transfer @ radiance).reshape(-1, 9)
        if sent is None or not self.gather:
            return direct
        with torch.no_grad():
            arrived = torch.stack([matrix @ sent.detach() for matrix in self.gather], dim=1)
            if received is not None:
                arrived = arrived * received.detach()[:, None]
        return direct + arrived.reshape(-1, 9)


def _component(operators: LightTransport, axis: int) -> torch.Tensor:
    """M before the cosine, times the axis' component of the direction; sparse [P, P]."""
    light = operators.light
    lit = (light.normals[light.hit_point] * light.directions[light.hit_direction]).sum(axis=1) > 0
    measure = light.directions[light.hit_direction, axis] * lit * (4 * math.pi / len(light.directions))
    bary = np.concatenate([1 - light.hit_bary.sum(axis=1, keepdims=True), light.hit_bary], axis=1)
    column, weight = locate(light.face_points, light.subdivision, light.hit_face, bary)
    count = len(light.points)
    key = np.repeat(light.hit_point.astype(np.int64), 3) * count + column.reshape(-1)
    unique, inverse = np.unique(key, return_inverse=True)
    value = np.bincount(inverse, weights=(weight * measure[:, None]).reshape(-1), minlength=len(unique))
    start = np.concatenate([[0], np.cumsum(np.bincount(unique // count, minlength=count))])
    return csr_tensor(start, unique % count, value.astype(np.float32), (count, count)).to(operators.transfer.device)
