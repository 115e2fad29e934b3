"""Chi-square over the cells of the sphere, for the tests of samplers."""

import math

import numpy as np
import torch

from exmesh_graph.shading import envmap


def chi_square_excess(observed, expected):
    """How many standard deviations the statistic lies above its mean; cells with too few samples are pooled."""
    few = expected < 10
    observed = torch.cat([observed[~few], observed[few].sum()[None]])
    expected = torch.cat([expected[~few], expected[few].sum()[None]])
    kept = expected > 0
    statistic = float(((observed - expected)[kept] ** 2 / expected[kept]).sum())
    degrees = max(int(kept.sum()) - 1, 1)
    return (statistic - degrees) / math.sqrt(2 * degrees)


def sphere_cells(direction, height=16, width=32):
    """Number of directions [N, 3] in each cell of a lat-long grid, float64 [height width]."""
    u, v = envmap.uv_of(direction.double())
    cell = (v * height).long().clamp(max=height - 1) * width + (u * width).long().clamp(max=width - 1)
    return torch.bincount(cell, minlength=height * width).double()


def sphere_integral(pdf, height=16, width=32, fine=24):
    """The integral of `pdf` (directions float64 [M, 3] -> [M]) over each of those cells, [height width]."""
    d = torch.from_numpy(envmap.texel_directions(height * fine, width * fine)).reshape(-1, 3)
    angle = torch.from_numpy(np.repeat(envmap.solid_angles(height * fine, width * fine), width * fine))
    return (pdf(d).double() * angle).reshape(height, fine, width, fine).sum(dim=(1, 3)).reshape(-1)
