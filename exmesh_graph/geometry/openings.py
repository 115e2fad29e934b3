"""Space inside a solid that is open through a lid: vessels, whose inside follows their outside at the wall's thickness.

Outlines never show how deep a vessel is, and dark glaze has nothing that stereo could find. But two lengths say almost
all: how thick the wall is and how deep the opening goes. So few can be tried, and few fit by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, label, map_coordinates

from exmesh_graph.geometry.adjacency import without_unused
from exmesh_graph.geometry.clean import taubin, without_pillows
from exmesh_graph.geometry.hull import Grid, surface
from exmesh_graph.geometry.lids import Lid
from exmesh_graph.geometry.repair import make_manifold
from exmesh_graph.geometry.settings import HullSettings
from exmesh_graph.geometry.soundness import require_sound

_THINNEST = 0.75  # voxels: below, the wall would be pierced
_WALLS = 0.05, 0.12, 0.25  # of the lid's radius, tried first, with each of the depths; then lengths between
_DEPTHS = 0.25, 0.5, 1.0, 2.0, 4.0
_FINER = 1.35, 1.15  # factors of a wall and a depth, as long as they help
_TRIES = 12  # with each of them
_SHALLOWEST = 0.25  # of the lid's radius: what is less deep is for Stage I
_HOPE = 0.06  # of the error: where none of those tried first gains so much, no other will gain enough
_ALMOST = 0.93  # of the largest gain
_LEAST = 60  # voxels
_LATE = 9  # steps of a third of a voxel: a ray that has not met the opening by then does not


@dataclass(frozen=True)
class Opening:
    """values float32 [I, J, K] on the grid: about the distance to the opening's border, positive in it; lid: what it is
    open through; wall and depth below the lid, in world units."""

    grid: Grid
    values: np.ndarray
    lid: Lid
    wall: float
    depth: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """float32 [P] at points [P, 3], trilinear; beyond the grid as at its border."""
        at = ((np.asarray(points, np.float64) - self.grid.origin) / self.grid.step).T
        return map_coordinates(self.values, at, order=1, mode="nearest")

    def exits(self, eyes: np.ndarray, rays: np.ndarray, start: np.ndarray, steps: int = 160) -> np.ndarray:
        """float32 [P]: how far along its ray from `start` on each leaves the opening, in lengths of `rays`.

        eyes, rays float [P, 3];  start float [P], where a ray enters
        The field is no further from the border than it says, so a step of it never leaps over one (sphere tracing);
        at least a third of a voxel, and at the end back by the secant.
        """
        length = np.linalg.norm(rays, axis=1)
        at, before = start.astype(np.float64), start.astype(np.float64)
        inner = np.zeros(len(at), np.float64)
        going = np.ones(len(at), bool)
        entry = np.zeros(len(at), bool)  # a ray may meet the lid a little before the opening begins
        for count in range(steps):
            todo = np.flatnonzero(going)
            if not len(todo):
                break
            now = self(eyes[todo] + at[todo, None] * rays[todo]).astype(np.float64)
            inside = now > 0
            entry[todo] |= inside
            out = ~inside & (entry[todo] | (count >= _LATE))
            ended = todo[out]
            share = np.where(entry[ended], inner[ended] / np.maximum(inner[ended] - now[out], 1e-12), 0.0)
            at[ended] = before[ended] + share * (at[ended] - before[ended])
            going[ended] = False
            on = todo[~out]
            inner[on], before[on] = np.maximum(now[~out], 0), np.where(inside[~out], at[on], before[on])
            at[on] += np.maximum(now[~out], self.grid.step / 3) / length[on]
        return np.where(entry, at, start).astype(np.float32)


class Lidded:
    """A solid (field [I, J, K], positive inside, and its surface), for its openings through one of its lids."""

    def __init__(self, values: np.ndarray, grid: Grid, vertices: np.ndarray, faces: np.ndarray, lid: Lid) -> None:
        self.grid, self.lid = grid, lid
        covered = np.zeros(len(faces), bool)
        covered[lid.faces] = True
        middles = vertices[faces].mean(1)
        points = grid.points().reshape(*grid.shape, 3)
        self.deep = ((lid.middle - points) @ lid.normal).astype(np.float32)
        self.below = _distance(points, grid, middles[~covered])
        self.below[(values < -2 * grid.step) | (self.deep < -3 * grid.step)] = -grid.step
        self.solid, self.rim = values > 0, np.zeros(grid.shape, bool)
        self.rim[_cells(middles[covered], grid)] = True

    def opening(self, wall: float, depth: float) -> Opening | None:
        """What is more than `wall` below every other part of the surface, to `depth` below the lid, and hangs together
        with the lid; None where that is next to nothing."""
        values = np.minimum(self.below - np.float32(wall), np.float32(depth) - self.deep)
        inside = self.solid & (values > 0)
        part_of, _ = label(inside | self.rim)
        held = np.isin(part_of, np.unique(part_of[self.rim]))
        if (inside & held).sum() < _LEAST:
            return None
        values[self.solid & (values > 0) & ~held] = -self.grid.step
        return Opening(self.grid, values, self.lid, wall, depth)

    def volume(self, opening: Opening) -> int:
        """Voxels of the solid that an opening takes."""
        return int((self.solid & (opening.values > 0)).sum())


def _distance(points: np.ndarray, grid: Grid, places: np.ndarray) -> np.ndarray:
    """float32 [I, J, K]: how far each point [I, J, K, 3] of the grid is from `places` [P, 3], to a fraction of a voxel:
    from the mean of those in the nearest cell that has any."""
    count, total = np.zeros(grid.shape, np.float32), np.zeros((*grid.shape, 3))
    at = _cells(places, grid)
    np.add.at(count, at, 1)
    np.add.at(total, at, places)
    nearest = distance_transform_edt(count == 0, return_distances=False, return_indices=True)
    middle = (total / np.maximum(count, 1)[..., None]).astype(np.float32)
    return np.linalg.norm(points - middle[tuple(nearest)], axis=-1).astype(np.float32)


def _cells(places: np.ndarray, grid: Grid) -> tuple[np.ndarray, ...]:
    at = np.round((places - grid.origin) / grid.step).astype(int)
    return tuple(np.clip(at, 0, np.array(grid.shape) - 1).T)


def opened(values: np.ndarray, grid: Grid, openings: Sequence[Opening]) -> tuple[np.ndarray, np.ndarray]:
    """Mesh (vertices float32 [V, 3], faces int32 [F, 3]), closed and manifold, of a field [I, J, K], positive inside,
    less the openings; smoothed as the hull is."""
    vertices, faces = surface(without(values, grid, openings), grid)
    vertices, faces = make_manifold(*without_unused(vertices, without_pillows(faces)))
    require_sound(vertices, faces, closed=True, where="openings")
    return taubin(vertices, faces, HullSettings().smooth), faces


def without(values: np.ndarray, grid: Grid, openings: Sequence[Opening]) -> np.ndarray:
    """A field [I, J, K], positive inside, less the openings, on any grid."""
    values = values.copy()
    for opening in openings:
        own = opening.grid
        held = np.argwhere(opening.values > -2 * own.step)
        low, high = own.origin + own.step * held.min(0), own.origin + own.step * held.max(0)
        first = np.maximum(np.floor((low - grid.origin) / grid.step).astype(int), 0)
        last = np.minimum(np.ceil((high - grid.origin) / grid.step).astype(int) + 1, grid.shape)
        part = tuple(slice(a, max(b, a)) for a, b in zip(first, last, strict=True))
        axes = [grid.origin[a] + grid.step * np.arange(grid.shape[a])[part[a]] for a in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        values[part] = np.minimum(values[part], -opening(points).reshape(values[part].shape))
    return values


def apart(mask: np.ndarray, grid: Grid, openings: Sequence[Opening]) -> np.ndarray:
    """The connected parts of a mask bool [I, J, K] that come no nearer to any opening than two grid steps."""
    parts, _ = label(mask)
    at = np.flatnonzero(mask)
    points, part = grid.points()[at], parts.ravel()[at]
    met = [np.unique(part[opening(points) > -2 * grid.step]) for opening in openings]
    return mask & ~np.isin(parts, np.concatenate(met)) if met else mask


def best_opening(lidded: Lidded, gain: Callable[[Opening], float]) -> Opening | None:
    """The least opening that gains almost as much as any (`gain`: by what share the error falls); None where little is
    to be gained.

    A few walls with a few depths first; then either length is made longer or shorter for as long as that helps. What
    lies deeper than photographs tell brings nothing, so of openings of nearly one gain the one of least volume is it.
    None, too, where shallower or thinner still would be better. Gloss on a flat lid shows its reflections behind it,
    and a shallow pit explains them a little; where what is beside the lid is open as well there is no wall.
    """
    radius, thinnest = lidded.lid.radius, _THINNEST * lidded.grid.step
    tried: dict[tuple[float, float], tuple[float, Opening | None]] = {}

    def value(wall: float, depth: float) -> float:
        if depth < _SHALLOWEST * radius:
            return -np.inf
        key = (max(wall, thinnest), depth)
        if key not in tried:
            opening = lidded.opening(*key)
            tried[key] = (-np.inf if opening is None else gain(opening), opening)
        return tried[key][0]

    for wall in _WALLS:
        for depth in _DEPTHS:
            value(wall * radius, depth * radius)
    best = max(tried, key=lambda key: (tried[key][0], key[0], -key[1]))
    if tried[best][0] < _HOPE:
        return None
    for factor in _FINER:
        for _ in range(_TRIES):
            wall, depth = best
            around = [(wall * factor, depth), (wall / factor, depth), (wall, depth * factor), (wall, depth / factor)]
            better = max(around, key=lambda key: value(*key))
            if value(*better) <= tried[best][0]:
                break
            best = (max(better[0], thinnest), better[1])
    most = tried[best][0]
    if best[1] < 1.05 * _SHALLOWEST * radius or best[0] < 1.2 * thinnest:
        return None
    able = [opening for value, opening in tried.values() if opening is not None and value >= _ALMOST * most]
    return min(able, key=lidded.volume)
