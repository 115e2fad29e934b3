"""Any object on a round table, to be photographed without masks (`benchmarks.scenes.photographs`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.model import Painter
from benchmarks.scenes.objects.tables import planks
from benchmarks.scenes.paint import mix, noise, step
from benchmarks.scenes.shapes import Solid, smooth, turned

#: Radius of a table over that of what stands on it; by how much of the table's radius it sinks in.
WIDER, SUNK = 1.45, 0.004


def _checks(p: np.ndarray) -> np.ndarray:
    return mix((0.55, 0.12, 0.10), (0.75, 0.72, 0.62), step(np.sin(22 * p[:, 0]) * np.sin(22 * p[:, 1]), 0, 0.1))


def _white(p: np.ndarray) -> np.ndarray:
    return np.array((0.8, 0.8, 0.78)) * (1 - 0.03 * noise(p, 40, 3, 2)[:, None])


def _granite(p: np.ndarray) -> np.ndarray:
    return mix((0.10, 0.10, 0.11), (0.55, 0.53, 0.50), 0.5 + 0.5 * noise(p, 28, 4, 4))


#: Colours of points [N, 3] in table radii, and roughness.
TOPS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "planks": (lambda p: planks(p)[0], 0.45),
    "lacquer": (lambda p: planks(p)[0], 0.12),
    "cloth": (_checks, 0.9),
    "white": (_white, 0.7),
    "granite": (_granite, 0.25),
}


def on_table(recipe: Recipe, top: str, light: str) -> Recipe:
    """The object of `recipe` on a table, seen from above it; `light`: one of `lights.WORLDS`, "" for the recipe's."""
    solids = list(recipe.solids())
    points = np.concatenate([chart.points for solid in solids for chart in solid.charts])
    middle = (points[:, :2].min(0) + points[:, :2].max(0)) / 2
    radius = WIDER * float(np.linalg.norm(points[:, :2] - middle, axis=1).max())
    at = np.array([*middle, points[:, 2].min() + SUNK * radius])
    return replace(
        recipe,
        solids=lambda: [_table().scaled(radius).moved(at), *solids],
        paint=_painted(recipe.paint, TOPS[top], at, radius),
        light=(light, recipe.seed % 97) if light else recipe.light,
        ground=("table",),
        heights=(0.12, 0.85),
        level=5.0,
        wander=False,
    )


def books(side: int, seed: int) -> np.ndarray:
    """Linear colour float32 [side, side, 3] of a shelf of books, which stands behind a turntable."""
    rng = np.random.default_rng(seed)
    seen = np.full((side, side, 3), 0.02, np.float32)
    row = side // 5
    for top in range(-rng.integers(row), side, row):
        left = 0
        while left < side:
            width, height = rng.integers(side // 60, side // 22), rng.integers(row * 7 // 10, row - 6)
            spine = seen[max(0, top + row - 6 - height) : max(0, top + row - 6), left : left + width - 2]
            spine[:] = rng.uniform(0.02, 0.7) * rng.dirichlet((2, 2, 2))
            for line in rng.integers(0, max(len(spine), 1), 5):
                spine[line : line + side // 200, 2:-2] = rng.uniform(0.05, 0.8, 3)
            left += width
    return seen


def _table() -> Solid:
    return turned(
        "table", [(0, -0.06), (0.97, -0.06)], smooth((0.97, -0.06), (1.0, -0.04), (1.0, -0.02)),
        smooth((1.0, -0.02), (0.995, -0.005), (0.98, 0.0), count=6), [(0.98, 0), (0.7, 0), (0, 0)], sides=120,
    )  # fmt: skip


def _painted(
    own: Painter, top: tuple[Callable[[np.ndarray], np.ndarray], float], at: np.ndarray, size: float
) -> Painter:
    def paint(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        base, rough, metal = own(p, n, part)
        table = part == "table"
        base = np.where(table[:, None], top[0](1.15 * (p - at) / size), np.broadcast_to(base, p.shape))
        return base, np.where(table, top[1], rough), np.where(table, 0, metal)

    return paint
