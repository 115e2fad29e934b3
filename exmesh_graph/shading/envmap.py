"""Lat-long environments on the Y-up world, in OpenEXR's convention.

    longitude = pi (1 - 2u),  latitude = pi (0.5 - v),  d = (sin lon cos lat, sin lat, cos lon cos lat)

(u, v) run right and down over the image: its centre is +Z, u = 0.25 is +X, row 0 is +Y. Texel (i, j) of H x W has
its centre at u = (j + 0.5) / W, v = (i + 0.5) / H. Lookups are bilinear, wrap in longitude and stop at the poles.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
import torch.nn.functional as F


def direction_of(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Unit directions [..., 3] of image coordinates u, v [...] in [0, 1]."""
    longitude, latitude = math.pi * (1 - 2 * u), math.pi * (0.5 - v)
    c = latitude.cos()
    return torch.stack([longitude.sin() * c, latitude.sin(), longitude.cos() * c], dim=-1)


def uv_of(direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Image coordinates (u, v) of unit directions [..., 3]; u in [0, 1] with the seam at -Z."""
    x, y, z = direction.unbind(-1)
    u = 0.5 - torch.atan2(x, z) / (2 * math.pi)
    v = torch.atan2((x * x + z * z).sqrt(), y) / math.pi
    return u, v


def texel_directions(height: int, width: int) -> np.ndarray:
    """Unit directions of the texel centres, float64 [H, W, 3]."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    return direction_of(torch.from_numpy(u), torch.from_numpy(v)).numpy()


def solid_angles(height: int, width: int) -> np.ndarray:
    """Solid angle of the texels of each row [sr], float64 [H]; `W` times their sum is exactly 4 pi."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return (edges[:-1] - edges[1:]) * (2 * np.pi / width)


@cache
def _row_weights(height: int, width: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """`solid_angles` as a tensor: brought to a GPU once, which would wait for each copy. Not to be written to."""
    return torch.as_tensor(solid_angles(height, width), dtype=dtype, device=device)


@cache
def _row_sines(height: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """`sines`, brought to a GPU once. Not to be written to."""
    return sines(height).to(device, dtype)


def bilinear(height: int, width: int, u: torch.Tensor, v: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The four texels under image coordinates [N]: flat indices int64 [N, 4] and weights [N, 4]."""
    x, y = u * width - 0.5, (v * height - 0.5).clamp(0, height - 1)
    x0, y0 = x.floor(), y.floor().clamp(max=max(height - 2, 0))
    fx, fy = x - x0, y - y0
    left = x0.long() % width
    right = (left + 1) % width
    top = y0.long()
    bottom = (top + 1).clamp(max=height - 1)
    index = torch.stack(
        [top * width + left, top * width + right, bottom * width + left, bottom * width + right], dim=-1
    )
    weight = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], dim=-1)
    return index, weight


def lookup(environment: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Radiance [..., 3] of `environment` [H, W, 3] towards unit directions [..., 3]; differentiable in the map."""
    height, width = environment.shape[:2]
    flat = direction.reshape(-1, 3)
    index, weight = bilinear(height, width, *uv_of(flat))
    texels = environment.reshape(-1, environment.shape[-1])[index]
    return (texels * weight[..., None].to(texels)).sum(-2).reshape(*direction.shape[:-1], -1)


def resample(environment: np.ndarray, height: int, width: int) -> np.ndarray:
    """The map at another resolution, float32 [height, width, 3].

    Each new texel averages bilinear samples spread over its area (solid-angle weighted), enough of them to visit every
    source texel; energy is kept to the accuracy of that quadrature.
    """
    rows, columns = environment.shape[:2]
    if (rows, columns) == (height, width):
        return environment.astype(np.float32)
    per_row, per_column = max(1, -(-2 * rows // height)), max(1, -(-2 * columns // width))
    v, u = np.meshgrid(
        (np.arange(height * per_row) + 0.5) / (height * per_row),
        (np.arange(width * per_column) + 0.5) / (width * per_column),
        indexing="ij",
    )
    source = torch.from_numpy(np.ascontiguousarray(environment, np.float64))
    index, weight = bilinear(rows, columns, torch.from_numpy(u).reshape(-1), torch.from_numpy(v).reshape(-1))
    fine = (source.reshape(-1, 3)[index] * weight[..., None]).sum(1)
    fine = fine.reshape(height, per_row, width, per_column, 3)
    sine = torch.from_numpy(np.sin(np.pi * v[:, 0])).reshape(height, per_row, 1, 1, 1)
    mean = (fine * sine).sum(dim=(1, 3)) / (sine.sum(dim=(1, 3)) * per_column)
    return mean.numpy().astype(np.float32)


#: Radiance from which a step of the parameter counts relatively: a sun of a thousand would not move otherwise.
BRIGHT = 20.0
#: Largest exponent there: radiance stays finite in float32, with any gain.
MOST = 60.0


def radiance_of(parameter: torch.Tensor) -> torch.Tensor:
    """The non-negative map of a free parameter: E = softplus(parameter), and from `BRIGHT` on an exponential that goes
    on as steeply."""
    above = BRIGHT * (parameter / BRIGHT - 1).clamp(0, MOST).exp()
    return torch.where(parameter > BRIGHT, above, F.softplus(parameter))


def parameter_of(radiance: torch.Tensor, least: float = 1e-4) -> torch.Tensor:
    """Inverse of `radiance_of`; radiance is floored at `least` so that no texel starts dead."""
    floored = radiance.clamp_min(least)
    above = BRIGHT * (1 + torch.log(floored / BRIGHT))
    return torch.where(floored > BRIGHT, above, torch.log(torch.expm1(floored.clamp(max=BRIGHT))))


def total_variation(environment: torch.Tensor) -> torch.Tensor:
    """L_env of eq. 23: mean absolute difference of neighbouring texels, wrapped in longitude.

    Differences are weighted by solid angle, so the crowded rows at the poles do not dominate the sum.

    Equation: 23.
    """
    height, width = environment.shape[:2]
    row = _row_weights(height, width, environment.dtype, environment.device)
    along = (environment - environment.roll(-1, dims=1)).abs().mean(dim=(1, 2))
    down = (environment[1:] - environment[:-1]).abs().mean(dim=(1, 2))
    between = 0.5 * (row[1:] + row[:-1])
    # a map of one row has no neighbours above each other
    return (along * row).sum() / row.sum() + (down * between).sum() / between.sum().clamp_min(1e-30)


def mean_radiance(environment: torch.Tensor) -> torch.Tensor:
    """Mean radiance over the sphere (solid-angle weighted), [3]."""
    row = _row_weights(*environment.shape[:2], environment.dtype, environment.device)
    return (environment.mean(dim=1) * row[:, None]).sum(dim=0) / row.sum()


#: About the mean `elevation` of light and its deviation: eight photographed rooms and skies and eighteen procedural
#: ones have 0.36 and 0.11 (`python -m benchmarks.scenes lights`), and none of them comes from below.
ABOVE, ABOVE_SPREAD = 0.35, 0.115


def elevation(environment: torch.Tensor) -> torch.Tensor:
    """How high the light stands: the mean sine of the elevation that radiance [H, W, 3] comes from, in [-1, 1]."""
    row = _row_weights(*environment.shape[:2], environment.dtype, environment.device)
    light = environment.mean(dim=(1, 2)) * row
    sine = _row_sines(len(light), environment.dtype, environment.device)
    return (light * sine).sum() / light.sum().clamp_min(1e-30)


def sines(height: int) -> torch.Tensor:
    """Sine of the elevation of a map's rows, float64 [height], the highest first."""
    return torch.from_numpy(np.sin(np.pi * (0.5 - (np.arange(height) + 0.5) / height)))


def too_low(environment: torch.Tensor) -> torch.Tensor:
    """Square of how much lower than usual the light stands, in deviations; 0 from `ABOVE` on.

    What faces up and what faces aside are often of unlike paints: then no photograph tells a dark roof under a bright
    sky from a light one under a dark sky.
    """
    return ((ABOVE - elevation(environment)) / ABOVE_SPREAD).clamp_min(0) ** 2


def chroma(environment: torch.Tensor) -> torch.Tensor:
    """L_chroma of eq. 24: squared distance of the mean radiance from its own grey value.

    Equation: 24.
    """
    mean = mean_radiance(environment)
    return ((mean - mean.mean()) ** 2).sum()


class Pyramid:
    """Halved copies of a map, for lookups that average over the solid angle a sample stands for."""

    def __init__(self, environment: torch.Tensor) -> None:
        levels = [environment]
        while levels[-1].shape[0] % 2 == 0 and levels[-1].shape[1] % 2 == 0 and levels[-1].shape[0] > 4:
            levels.append(_halve(levels[-1]))
        self.levels = levels
        self.texel = 4 * math.pi / (environment.shape[0] * environment.shape[1])

    def lookup(self, direction: torch.Tensor, solid_angle: torch.Tensor) -> torch.Tensor:
        """Radiance [N, 3] averaged over about `solid_angle` [N] sr around unit directions [N, 3]."""
        level = 0.5 * torch.log2((solid_angle / self.texel).clamp_min(1e-12))
        level = level.clamp(0, len(self.levels) - 1)
        base = level.floor()
        u, v = uv_of(direction)
        result = torch.zeros_like(direction)
        for number, image in enumerate(self.levels):
            share = torch.where(base == number, 1 - (level - base), torch.zeros_like(level))
            share = torch.where(base == number - 1, level - base, share)
            chosen = torch.nonzero(share > 0)[:, 0]
            if len(chosen) == 0:
                continue
            height, width = image.shape[:2]
            index, weight = bilinear(height, width, u[chosen], v[chosen])
            values = torch.nn.functional.embedding_bag(
                index, image.reshape(-1, 3), per_sample_weights=weight * share[chosen, None], mode="sum"
            )
            result.index_add_(0, chosen, values)
        return result


def _halve(environment: torch.Tensor) -> torch.Tensor:
    height, width = environment.shape[:2]
    row = _row_weights(height, width, environment.dtype, environment.device)
    row = row.reshape(height // 2, 2, 1, 1, 1)
    blocks = environment.reshape(height // 2, 2, width // 2, 2, 3)
    return (blocks * row).sum(dim=(1, 3)) / (row.sum(dim=1)[:, 0] * 2)
