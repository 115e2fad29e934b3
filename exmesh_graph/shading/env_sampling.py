"""Importance sampling of a lat-long environment, by a density built on the same bilinear weights as its lookup.

With b_ij the bilinear basis of `envmap.lookup` over image coordinates (u, v), s_i = sin(theta) of row i's centre:

    p(u, v) = H W sum_ij w_ij s_i b_ij(u, v) / sum_ij w_ij s_i,      p(d) = p(u, v) / (2 pi^2 sin(theta))
    w_ij    = (1 - uniform) E_ij / mean(E) + uniform                 E_ij: mean of the texel's three channels

E(d) / p(d) is then nearly constant over the sphere: next to a sun the density falls off exactly as the interpolated
radiance does. A density that is constant over texels would be too low by up to 4 there; one for nearest values would
belong to another picture than the lookup's.
"""

from __future__ import annotations

import math

import torch

from exmesh_graph.errors import NumericsError
from exmesh_graph.shading import envmap

#: Least sine of the polar angle in the density: it grows like 1 / sin(theta) at the poles themselves.
_SINE_MIN = 1e-7


class EnvSampler:
    """Directions drawn in proportion to the radiance of `environment` [H, W, 3], and their density.

    The density is a detached copy: frozen while the environment goes on changing, until a new sampler is built from
    it. A frozen density stays right for the changed environment (only less well matched), because it is positive
    everywhere: `uniform`, a number in (0, 1], is the share of samples that ignore the radiance, so that black texels
    are still visited and keep their gradient.

    Raises NumericsError for radiance that is negative or not finite.
    """

    def __init__(self, environment: torch.Tensor, uniform: float = 0.05) -> None:
        if not 0 < uniform <= 1:
            raise ValueError(f"uniform must lie in (0, 1], got {uniform}")
        radiance = environment.detach().double()
        bad = torch.nonzero(~(torch.isfinite(radiance) & (radiance >= 0)))
        if len(bad):
            row, column, channel = bad[0].tolist()
            raise NumericsError(
                f"cannot sample an environment with radiance {float(radiance[row, column, channel])}",
                where=f"row {row}, column {column}",
                expected="finite radiance >= 0 (envmap.radiance_of gives it for any parameter)",
            )
        value = radiance.mean(dim=-1)
        height, width = value.shape
        theta = (torch.arange(height, dtype=torch.float64, device=value.device) + 0.5) * (math.pi / height)
        sine = theta.sin()[:, None]
        mean = (value * sine).sum() / (sine.sum() * width)
        relative = value / mean if float(mean) > 0 else torch.ones_like(value)
        mass = ((1 - uniform) * relative + uniform) * sine
        mass = mass / mass.sum()
        self.shape = (height, width)
        self.dtype = environment.dtype
        #: p(u, v) at the texel centres, [H, W]; between them the lookup's own interpolation
        self.density = (mass * (height * width)).to(environment.dtype)
        # float64, so that a sun's neighbours keep their width in the cumulated sums
        self._rows = _cumulated(mass.sum(dim=1)[None])
        self._columns = _cumulated(mass)

    def sample(self, uniform: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Unit directions [N, 3] and their densities [N] per steradian, from points [N, 2] in [0, 1)^2.

        Continuous in each coordinate up to the grid, so that stratified points stay stratified over the sphere.
        """
        height, width = self.shape
        first, second = uniform.double().unbind(-1)
        row, inside_row = _draw(self._rows, height, torch.zeros_like(first, dtype=torch.int64), first)
        column, inside_column = _draw(self._columns, width, row, second)
        # the lookup stops half a texel before the poles: what a tent throws over the edge folds back
        y = row + 0.5 + tent(inside_row)
        y = torch.where(y < 0, -y, torch.where(y > height, 2 * height - y, y))
        u = ((column + 0.5 + tent(inside_column)) / width) % 1
        v = y / height
        direction = envmap.direction_of(u, v)
        return direction.to(self.dtype), self._density(u.to(self.dtype), v.to(self.dtype), (math.pi * v).sin())

    def pdf(self, direction: torch.Tensor) -> torch.Tensor:
        """Density per steradian [...] of unit directions [..., 3]; positive and finite everywhere."""
        flat = direction.reshape(-1, 3)
        sine = (flat[:, 0] ** 2 + flat[:, 2] ** 2).sqrt()
        return self._density(*envmap.uv_of(flat), sine).reshape(direction.shape[:-1])

    def _density(self, u: torch.Tensor, v: torch.Tensor, sine: torch.Tensor) -> torch.Tensor:
        index, weight = envmap.bilinear(*self.shape, u, v)
        value = (self.density.reshape(-1)[index] * weight.to(self.density)).sum(-1)
        return value / (2 * math.pi**2 * sine.clamp_min(_SINE_MIN)).to(value)


def _cumulated(mass: torch.Tensor) -> torch.Tensor:
    """Row r's cumulated shares of `mass` [R, K], raised by r: one increasing list [R K], to be searched at once."""
    share = mass.cumsum(1) / mass.sum(dim=1, keepdim=True)
    share[:, -1] = 1
    return (share + torch.arange(len(mass), device=mass.device)[:, None]).reshape(-1)


def _draw(
    cumulated: torch.Tensor, count: int, row: torch.Tensor, uniform: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """The entry [N] of the given row that holds `uniform` [N], and how far into it, in [0, 1]."""
    target = row + uniform
    flat = torch.searchsorted(cumulated, target, right=True)
    flat = torch.minimum(torch.maximum(flat, row * count), row * count + count - 1)
    below = torch.where(flat > row * count, cumulated[(flat - 1).clamp_min(0)], row.to(cumulated))
    step = cumulated[flat] - below
    share = torch.where(step > 0, (target - below) / step, torch.full_like(step, 0.5))
    return flat - row * count, share.clamp(0, 1)


def tent(uniform: torch.Tensor) -> torch.Tensor:
    """A number in [-1, 1] with density 1 - |x|, from one in [0, 1]; increasing."""
    low = (2 * uniform).clamp_min(0).sqrt() - 1
    high = 1 - (2 * (1 - uniform)).clamp_min(0).sqrt()
    return torch.where(uniform < 0.5, low, high)
