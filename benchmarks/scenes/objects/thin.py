"""Thin parts and holes: a chair of rods, a plant in a pot."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.paint import mix, noise, step, wood
from benchmarks.scenes.shapes import Solid, box, leaf, rod, smooth, tube, turn, turned


def chair() -> list[Solid]:
    """A seat on four splayed legs with stretchers, nine spindles under a bent rail, two arms."""
    found = [box("seat", (0.46, 0.44, 0.035), 0.03).moved((0, 0, 0.9))]
    feet = {}
    for x in (-1, 1):
        for y in (-1, 1):
            top, foot = np.array([0.36 * x, 0.34 * y, 0.89]), np.array([0.5 * x, 0.47 * y, 0.0])
            feet[x, y] = foot + 0.35 * (top - foot), foot + 0.5 * (top - foot)
            where = np.linspace(0, 1, 15)
            swell = 0.026 + 0.012 * np.sin(np.pi * where) + 0.006 * np.sin(6 * np.pi * where)
            found.append(tube("leg", foot + where[:, None] * (top - foot), swell))
    for x in (-1, 1):
        found.append(rod("stretcher", feet[x, -1][0], feet[x, 1][0], 0.016))
    found.append(rod("stretcher", (feet[-1, -1][0] + feet[-1, 1][0]) / 2, (feet[1, -1][0] + feet[1, 1][0]) / 2, 0.016))
    for y in (-1, 1):
        found.append(rod("stretcher", feet[-1, y][1], feet[1, y][1], 0.014))
    angle = np.linspace(-68, 68, 31) * np.pi / 180
    rail = np.stack([0.5 * np.sin(angle), 0.5 * np.cos(angle) - 0.02, 1.55 + 0.14 * np.cos(angle)], -1)
    found.append(tube("rail", rail, 0.028 + 0.008 * np.cos(angle)))
    for k in np.linspace(2, 28, 9).round().astype(int):
        foot = np.array([0.41 * np.sin(angle[k]), 0.40 * np.cos(angle[k]) - 0.02, 0.92])
        found.append(rod("spindle", foot, rail[k], 0.0135, sides=10))
    for x in (-1, 1):
        arm = [(0.53 * x, 0.18, 1.33), (0.56 * x, 0.0, 1.26), (0.54 * x, -0.2, 1.22), (0.5 * x, -0.36, 1.21)]
        found.append(tube("arm", curve([(0.47 * x, 0.24, 1.40), *arm]), 0.026))
        found.append(rod("post", (0.42 * x, -0.34, 0.92), (0.5 * x, -0.33, 1.21), 0.015))
    return found


def curve(points: list[tuple[float, ...]], count: int = 28) -> np.ndarray:
    """A smooth line [count, 3] through the points."""
    from scipy.interpolate import CubicSpline

    line = np.asarray(points, float)
    where = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return CubicSpline(where, line)(np.linspace(0, where[-1], count))


def paint_chair(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    seat, dark = np.isin(part, ("seat", "rail", "arm")), np.isin(part, ("spindle", "post"))
    grain = np.where(seat, wood(p, 3, axis=0, scale=1.2), wood(p, 5, axis=2, scale=1.6))
    colour = mix((0.33, 0.15, 0.06), (0.62, 0.36, 0.16), grain)
    rings = step(np.sin(p[:, 2] * 42), 0.55, 0.2)
    painted = mix((0.03, 0.18, 0.22), (0.72, 0.62, 0.42), rings)
    colour = np.where(np.isin(part, ("leg",))[:, None], painted, colour)
    colour = np.where(dark[:, None], mix((0.45, 0.05, 0.04), (0.55, 0.12, 0.07), grain), colour)
    return colour, 0.38 + 0.2 * grain, np.zeros(len(p))


def plant() -> list[Solid]:
    """Forty-eight leaves on eight stems in a pot of clay."""
    rng = np.random.default_rng(12)
    pot = turned(
        "pot", [(0, 0), (0.26, 0)], smooth((0.26, 0), (0.31, 0.22), (0.35, 0.42)), [(0.35, 0.42), (0.385, 0.42)],
        [(0.385, 0.42), (0.39, 0.53)], [(0.39, 0.53), (0.34, 0.53)], [(0.34, 0.53), (0.335, 0.46)],
        [(0.335, 0.46), (0.2, 0.475), (0, 0.48)],
    )  # fmt: skip
    found = [pot]
    for stem in range(8):
        azimuth = stem * 137.5 + rng.uniform(-15, 15)
        lean, tall = rng.uniform(0.1, 0.5), rng.uniform(0.8, 1.25)
        out = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0])
        share = np.linspace(0, 1, 15)[:, None]
        path = 0.06 * out + lean * share**2 * out + [0, 0, 0.46] + share * [0, 0, tall]
        found.append(tube("stem", path, np.linspace(0.016, 0.007, 15), sides=8))
        for k in range(6):
            at = path[int(4 + 2 * k)] if k < 5 else path[-1]
            size = rng.uniform(0.30, 0.44) * (1.1 - 0.08 * k)
            blade = leaf("leaf", size, 0.36 * size * rng.uniform(0.8, 1.1), 0.006, rng.uniform(0.5, 1.3))
            heading = turn(2, azimuth + k * 137.5 + rng.uniform(-20, 20)) @ turn(1, -rng.uniform(15, 50))
            found.append(blade.moved(at, heading @ turn(0, rng.uniform(-15, 15)), name=f"leaf {rng.uniform():.3f}"))
    return found


def paint_plant(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    clay = mix((0.42, 0.17, 0.09), (0.58, 0.28, 0.16), 0.5 + 0.5 * noise(p, 7, 4, 3))
    band = step(np.abs(p[:, 2] - 0.30 - 0.02 * np.sin(14 * np.arctan2(p[:, 1], p[:, 0]))), 0.035, 0.006)
    clay = mix((0.75, 0.70, 0.58), clay, band)
    soil = mix((0.05, 0.03, 0.02), (0.16, 0.10, 0.06), 0.5 + 0.5 * noise(p, 30, 6, 2))
    clay = np.where(((np.hypot(p[:, 0], p[:, 1]) < 0.334) & (p[:, 2] > 0.44))[:, None], soil, clay)
    names, which = np.unique(part, return_inverse=True)
    tone = np.array([float(name.split()[1]) if name.startswith("leaf ") else 0.5 for name in names])[which]
    green = mix((0.05, 0.20, 0.04), (0.20, 0.36, 0.07), tone)
    spots = step(noise(p, 16, 8, 2), 0.25, 0.2)
    green = mix(green, (0.55, 0.58, 0.22), 0.8 * spots)
    leafy, stem = np.char.startswith(part, "leaf "), part == "stem"
    colour = np.where(leafy[:, None], green, np.where(stem[:, None], (0.22, 0.20, 0.08), clay))
    rough = np.where(leafy, 0.32 + 0.15 * spots, np.where(stem, 0.5, 0.75))
    return colour, rough, np.zeros(len(p))


SCENES = {
    "chair": Recipe(chair, paint_chair, ("day", 21), 100, heights=(-0.35, 0.92)),
    "plant": Recipe(plant, paint_plant, ("city", 130), 200, heights=(-0.3, 0.92)),
}
