"""Which surface photographs foretell one another best over: the hull, or what they let depth maps take away of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from exmesh_graph.evaluate.metrics import removable, rephotography
from exmesh_graph.geometry import openings
from exmesh_graph.geometry.carve import Carving
from exmesh_graph.geometry.closed import solid_surface
from exmesh_graph.geometry.coarse_start import BENT, ROUGH, SURFACES, better, bolder, surface_row, uncarved_row
from exmesh_graph.geometry.hull import Grid, resampled
from exmesh_graph.io.train_size import reduced
from exmesh_graph.masks.regained import regained
from exmesh_graph.types import DepthMaps, Mesh, Views

Solid = Callable[[int], tuple[np.ndarray, Grid]]
"""A field [I, J, K], positive inside, and its grid, by resolution; 0: as fine as photographs show."""


class Kept(NamedTuple):
    """A surface: whose it is (`coarse_start.SURFACES`), the solid below its mouths, and these."""

    name: str
    mesh: Mesh
    solid: Solid
    mouths: Sequence[openings.Opening] = ()


def kept_surface(
    hull: Kept,
    carvings: Mapping[str, Carving],
    maps: Mapping[str, DepthMaps],
    views: Views,
    shown: Views,
    factor: int,
    *,
    resolution: int = 0,
    found: bool = False,
    where: str = "evaluate.surfaces",
) -> tuple[Kept, list[dict[str, Any]]]:
    """(the surface that is kept, a row of the decisions for each carving).

    carvings, maps  what depth maps of each kind (`stereo`, `pgsr`) carve, and these
    views, shown  the photographs, and the same in one exposure, in which they foretell one another
    factor  by which pictures are reduced before they are compared
    resolution  of the carved solid where its own grid is asked for
    found  whether the masks were found, and so err

    Beside the mouths of the hull's vessels carving is judged as elsewhere; in them it must gain more, for two lengths
    tell the inside of a cup better than noisy depth does.
    """
    foretold = rephotography.Foretold(reduced(shown, factor))
    best, scores = hull, foretold.scores((hull.mesh.vertices, hull.mesh.faces))
    rows = []
    for name, carving in carvings.items():
        lets = removable.removable(carving, shown, maps[name])
        ways = [_Way([], lets, ROUGH if best.mouths else BENT)]
        if mouths := list(best.mouths):
            ways.append(_Way(mouths, [openings.apart(let, carving.grid, mouths) for let in lets], BENT))
        tried = [one for way in ways if (one := _tried(way, carving, views, foretold, scores, found, where))]
        if not tried:
            rows.append(uncarved_row(SURFACES[name], best.name))
            continue
        one = max(tried, key=lambda one: (better(one.gain, one.detail, one.way.least), one.gain[0] - one.gain[1]))
        rows.append(surface_row(one.gain, one.detail, SURFACES[name], best.name, one.way.least))
        if rows[-1]["value"] == SURFACES[name]:
            solid = carved_solid(one.made.values, carving.grid, resolution)
            best, scores = Kept(SURFACES[name], one.made.mesh, solid, one.way.mouths), one.made.scores
    return best, rows


def carved_solid(values: np.ndarray, grid: Grid, own: int) -> Solid:
    """The solid of a carved field [I, J, K], which at the resolution `own` is the field itself."""
    return lambda resolution: (values, grid) if resolution == own else resampled(values, grid, resolution)


class _Way(NamedTuple):
    """Mouths that stay open, what may go beside them, from the most careful choice to the boldest, and the least gain
    in dB that tells."""

    mouths: list[openings.Opening]
    lets: list[np.ndarray]
    least: float


class _Made(NamedTuple):
    mesh: Mesh
    values: np.ndarray
    scores: rephotography.Scores


class _Tried(NamedTuple):
    """What one way comes to, and its gain over what was kept, (dB, standard error), in all and in details."""

    way: _Way
    made: _Made
    gain: tuple[float, float]
    detail: tuple[float, float]


def _tried(
    way: _Way, carving: Carving, views: Views, foretold: rephotography.Foretold, kept: rephotography.Scores,
    found: bool, where: str,
) -> _Tried | None:  # fmt: skip
    """The most careful choice of a way, or a bolder one that photographs prefer to it; None where nothing may go."""
    made = []
    for let in way.lets:
        if let.any():
            mesh, values = _carved(carving, let, way.mouths, views, found, where)
            made.append(_Made(mesh, values, foretold.scores((mesh.vertices, mesh.faces))))
    if not made:
        return None
    careful, *others = made
    bold = [one for one in others if bolder(*_gains(careful.scores, one.scores))]
    chosen = max(bold, key=lambda one: one.scores.picture.mean(), default=careful)
    return _Tried(way, chosen, *_gains(kept, chosen.scores))


def _gains(before: rephotography.Scores, after: rephotography.Scores) -> list[tuple[float, float]]:
    return [rephotography.gain(*parts) for parts in zip(before, after, strict=True)]


def _carved(
    carving: Carving, let: np.ndarray, mouths: list[openings.Opening], views: Views, found: bool, where: str
) -> tuple[Mesh, np.ndarray]:
    """(the hull less what is `let` go [I, J, K] of what depth maps carve, and its mouths; its field without these)."""
    values = regained(carving.field(carving.taken & ~let), carving, views, found=found)
    made = openings.opened(values, carving.grid, mouths) if mouths else solid_surface(values, carving.grid, 0, where)
    return Mesh(*made), values
