"""Iterations over all views of a level: each colour of the checkerboard takes better planes from the other."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from exmesh_graph.gpu.cores import split
from exmesh_graph.priors.patch_match.layout import NO_PIXEL, Level, planes_of

TILT = 5.0
"""Most change of depth, as a share of it, over a focal length: planes steeper than some 79 degrees are not tried."""
_COLOUR = 0.12 * 255  # spread of the bilateral weights, in grey levels
_ROWS = 4  # of a piece of work


@dataclass(frozen=True)
class Comparison:
    """What planes are judged by on a level.

    matrices  float32 [N, S, 24], chosen int32 [N, S], bounds float32 [N, 4]: of `sources`, at this level's size
    best      costs of so many sources, the least, are averaged
    radius    samples on either side of the middle of a window, `step` pixels apart
    trials    random planes tried in an iteration
    """

    matrices: torch.Tensor
    chosen: torch.Tensor
    bounds: torch.Tensor
    best: int
    radius: int
    step: int
    trials: int


def iterate(
    level: Level,
    state: torch.Tensor,
    comparison: Comparison,
    *,
    turn: int,
    sizes: tuple[float, float],
    bend: float = 0.0,
    weight: float = 0.0,
    far: float = 3.0,
    refresh: bool = False,
) -> None:
    """One iteration over `state` (in place).

    turn     numbers the iterations of a run: with view and pixel it fixes the random trials
    sizes    least and most size of a trial of depth: powers of 2 of a pixel's shift in the sources; `bend` the power of
             2 up to which slopes are changed
    weight   of the geometric term: weight min(pixels, far) by which a point misses its pixel, there and back by the
             source's own depth as it was before the iteration; 0: none
    refresh  judge the planes at hand anew first
    """
    from exmesh_graph.priors.patch_match.kernels import propagate_rows

    numbers = torch.tensor([0.70710678 / _COLOUR, weight, far, *sizes, bend, TILT], dtype=torch.float32)
    found = found_planes(state, level.width) if weight > 0 else state.new_zeros(1)
    count, sources = comparison.chosen.shape
    for colour in (0, 1):
        split(
            propagate_rows, count * level.height, colour, level.height, level.width, level.stride, sources,
            comparison.best, comparison.radius, comparison.step, comparison.trials, int(refresh), turn, numbers,
            comparison.bounds.reshape(-1), comparison.matrices.reshape(-1), comparison.chosen.reshape(-1),
            level.reference.reshape(-1), level.packed.reshape(-1), level.inside.reshape(-1), found.reshape(-1),
            state.reshape(-1), grain=_ROWS,
        )  # fmt: skip


def found_planes(state: torch.Tensor, width: int) -> torch.Tensor:
    """[N, 3, H, W], w, du and dv; 0 where there is no pixel."""
    planes = planes_of(state, width)
    return torch.where(planes[:, 3:] < 0.1 * NO_PIXEL, planes[:, :3], 0.0).contiguous()
