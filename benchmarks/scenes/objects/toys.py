"""Three more small scenes for choosing (256 pixels): a lacquered toy car with a little metal, a lamp whose thin shade
is open below, and a cottage, whose flat walls face few ways."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.paint import mix, noise, printed, step, writing
from benchmarks.scenes.shapes import Solid, ball, blend, block, box, level_set, rod, smooth, tube, turn, turned


def buggy() -> list[Solid]:
    """A toy car: a lacquered body with a cabin, chrome bumpers and lamps, rubber wheels under wings."""

    def distance(p: np.ndarray) -> np.ndarray:
        hull = block(p, (0, 0, 0.30), (0.95, 0.40, 0.15), 0.10)
        cabin = block(p, (-0.12, 0, 0.55), (0.42, 0.32, 0.20), 0.12)
        return blend(hull, cabin, 0.10)

    found = [level_set("body", distance, 1.1, cells=180)]
    for x in (-0.58, 0.58):
        for y in (-0.42, 0.42):
            wheel = tube("tyre", ring((0, 0, 0), 0.15, 48), 0.07, sides=18, closed=True)
            found.append(wheel.moved((x, y, 0.20), turn(0, 90)))
            found.append(rod("hub", (x, y - 0.06, 0.20), (x, y + 0.06, 0.20), 0.13, sides=32))
    for x in (-1.0, 1.0):
        found.append(rod("chrome", (x, -0.36, 0.22), (x, 0.36, 0.22), 0.035, sides=18))
        for y in (-0.25, 0.25):
            found.append(rod("chrome", (0.85 * x, y, 0.24), (x, y, 0.22), 0.025))
            found.append(ball("lamp", (0.95 * x, 1.05 * y, 0.36), (0.05, 0.085, 0.085)))
    return found


def paint_buggy(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    number = printed(writing(("42",), 96, 64), 0.5 + (x + 0.12) / 0.5 * np.sign(-y), 0.5 + (z - 0.31) / 0.22)
    stripe = step(0.09 - np.abs(y), 0.0, 0.01) * (z > 0.3)
    red = mix([0.42, 0.03, 0.025], [0.82, 0.78, 0.66], np.maximum(stripe, number * (np.abs(y) > 0.3)))
    glass = (z > 0.50) & (z < 0.68) & (np.abs(n[:, 2]) < 0.75)
    base = np.where(glass[:, None], [0.03, 0.035, 0.045], red)
    rough = np.where(glass, 0.12, 0.22 + 0.04 * noise(p, 6, 3, 2))
    metal = np.zeros(len(p))
    for name, colour, gloss, steel in (
        ("tyre", (0.03, 0.03, 0.03), 0.75, 0), ("hub", (0.56, 0.55, 0.53), 0.3, 1),
        ("chrome", (0.62, 0.62, 0.61), 0.15, 1), ("lamp", (0.75, 0.70, 0.45), 0.2, 0),
    ):  # fmt: skip
        mine = part == name
        base[mine], rough[mine], metal[mine] = colour, gloss, steel
    return base, rough, metal


def lamp() -> list[Solid]:
    """A table lamp: a linen shade two hundredths thick, open above and below, on a turned glazed foot."""
    low, high, thick = 0.62, 0.36, 0.02
    shade = turned(
        "shade",
        smooth((low, 0.0), (0.47, 0.4), (high, 0.75)),
        [(high, 0.75), (high - thick, 0.75)],
        smooth((high - thick, 0.75), (0.47 - thick, 0.4), (low - thick, 0.0)),
        [(low - thick, 0.0), (low, 0.0)],
        sides=96,
    )
    foot = turned(
        "foot",
        [(0.0, -0.85), (0.34, -0.85)],
        smooth((0.34, -0.85), (0.36, -0.80), (0.16, -0.70), (0.12, -0.6), (0.24, -0.38), (0.22, -0.2), (0.07, -0.06)),
        [(0.07, -0.06), (0.0, -0.06)],
    )
    arms = [rod("brass", (0, 0, 0.5), (0.42 * np.cos(a), 0.42 * np.sin(a), 0.5), 0.014) for a in np.arange(3) * 2.0944]
    return [
        shade,
        foot,
        rod("brass", (0, 0, -0.1), (0, 0, 0.5), 0.03),
        ball("bulb", (0, 0, 0.36), (0.1, 0.1, 0.13)),
        *arms,
    ]


def paint_lamp(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    angle = np.arctan2(y, x)
    weave = noise(np.column_stack([angle * 14, z * 60, np.zeros(len(p))]), 1.0, 5)
    bands = step(np.sin(angle * 12), 0.3, 0.1) * (n[:, 0] * x + n[:, 1] * y > 0)
    base = mix(mix([0.78, 0.74, 0.64], [0.30, 0.40, 0.42], bands), [0.70, 0.66, 0.56], 0.25 + 0.25 * weave)
    rough, metal = np.full(len(p), 0.85), np.zeros(len(p))
    glaze = mix([0.05, 0.16, 0.22], [0.45, 0.50, 0.42], step(noise(p, 3.0, 8, 3), 0.1, 0.3))
    for name, colour, gloss, steel in (
        ("foot", glaze, 0.25, 0), ("brass", (0.62, 0.46, 0.20), 0.3, 1), ("bulb", (0.80, 0.80, 0.78), 0.35, 0),
    ):  # fmt: skip
        mine = part == name
        base[mine] = colour[mine] if isinstance(colour, np.ndarray) else colour
        rough[mine], metal[mine] = gloss, steel
    return base, rough, metal


def cottage() -> list[Solid]:
    """A toy house: walls with windows and doors, two slopes of slates, a chimney, a stoop, a bench."""
    found = [
        box("wall", (0.62, 0.46, 0.42), 0.006).moved((0, 0, 0.12)),
        box("wall", (0.438, 0.46, 0.438), 0.006).moved((0, 0, 0.54), turn(1, 45)),
    ]
    for side in (-1, 1):
        found.append(box("roof", (0.52, 0.53, 0.025), 0.006).moved((side * 0.37, 0, 0.824), turn(1, side * 45)))
    found.append(box("chimney", (0.09, 0.09, 0.26), 0.006).moved((0.30, 0.20, 1.05)))
    found.append(box("stoop", (0.22, 0.10, 0.05), 0.006).moved((0, -0.53, -0.25)))
    found.append(box("seat", (0.30, 0.07, 0.02), 0.005).moved((0.05, 0.56, -0.08)))
    for x in (-0.2, 0.3):
        found.append(box("seat", (0.02, 0.06, 0.11), 0.005).moved((x, 0.56, -0.2)))
    return found


def paint_cottage(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    plaster = mix([0.56, 0.50, 0.40], [0.66, 0.61, 0.52], 0.5 + 0.5 * noise(p, 3, 4, 4))
    courses = np.maximum(
        step(np.abs(np.mod(z * 9, 1) - 0.5), 0.42, 0.04),
        step(np.abs(np.mod((x + y) * 4 + 0.5 * (np.floor(z * 9) % 2), 1) - 0.5), 0.46, 0.02),
    )
    stones = mix([0.26, 0.24, 0.22], [0.40, 0.36, 0.31], 0.5 + 0.5 * noise(p, 6, 7, 2))
    stones = mix(stones, [0.12, 0.11, 0.10], courses)
    base = np.where((z < -0.05)[:, None], stones, plaster)
    rough = np.where(z < -0.05, 0.8, 0.85)
    # along the wall: (axis it faces, side, middle, height, half width, half height, what)
    for axis, side, at, high, wide, tall, what in (
        (1, -1, 0.0, 0.10, 0.13, 0.30, 0), (1, -1, -0.38, 0.28, 0.12, 0.14, 1), (1, -1, 0.38, 0.28, 0.12, 0.14, 1),
        (1, 1, -0.25, 0.30, 0.14, 0.14, 1), (1, 1, 0.30, 0.30, 0.12, 0.14, 1), (1, -1, 0.0, 0.72, 0.09, 0.09, 1),
        (0, 1, 0.05, 0.25, 0.16, 0.14, 1), (0, -1, -0.15, 0.28, 0.13, 0.14, 1), (0, -1, 0.22, 0.10, 0.11, 0.29, 0),
    ):  # fmt: skip
        u, v = (p[:, 1 - axis] - at) / wide, (z - high) / tall
        facing = (n[:, axis] * side > 0.9) & (part == "wall")
        paint = np.array([0.10, 0.22, 0.34]) if what else np.array([0.30, 0.07, 0.05])
        frame, pane = facing & (np.maximum(np.abs(u), np.abs(v)) < 1), what & (np.maximum(np.abs(u), np.abs(v)) < 0.8)
        bars = np.minimum(np.abs(u), np.abs(v)) < 0.08
        base = np.where(frame[:, None], np.where((pane & ~bars)[:, None], [0.05, 0.06, 0.07], paint), base)
        rough = np.where(frame, np.where(pane & ~bars, 0.2, 0.45), rough)
    along = np.abs(x) * 1.5
    row = np.floor(along * 9)
    gaps = np.maximum(
        step(np.abs(np.mod(along * 9, 1) - 0.5), 0.42, 0.04),
        step(np.abs(np.mod(y * 8 + 0.5 * (row % 2), 1) - 0.5), 0.45, 0.03),
    )
    each = noise(np.column_stack([row, np.floor(y * 8 + 0.5 * (row % 2)), np.sign(x)]), 1.7, 9)
    slates = mix(mix([0.15, 0.17, 0.20], [0.26, 0.27, 0.28], 0.5 + 0.5 * each), [0.06, 0.06, 0.07], gaps)
    brick = mix([0.42, 0.17, 0.11], [0.50, 0.46, 0.40], courses)
    grain = mix([0.38, 0.24, 0.12], [0.50, 0.34, 0.18], 0.5 + 0.5 * noise(p * [2, 30, 30], 1, 5, 2))
    for name, colour, gloss in (("roof", slates, 0.55), ("chimney", brick, 0.8), ("stoop", stones, 0.8),
                                ("seat", grain, 0.5)):  # fmt: skip
        mine = part == name
        base[mine], rough[mine] = colour[mine], gloss
    return base, rough, np.zeros(len(p))


SCENES = {
    "cottage": Recipe(cottage, paint_cottage, ("day", 83), 420, heights=(-0.2, 0.9)),
    "buggy": Recipe(buggy, paint_buggy, ("courtyard", 70), 400, heights=(-0.25, 0.92), level=9.0),
    "lamp": Recipe(lamp, paint_lamp, ("interior", 160), 410, heights=(-0.45, 0.9)),
}
