"""Walls: flat ones with fine writing (a kiosk), hollow ones that colour one another (a grotto)."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.paint import mix, noise, printed, sentences, step, writing
from benchmarks.scenes.shapes import Solid, ball, blend, block, box, carve, ellipsoid, level_set, rod, turn


def kiosk() -> list[Solid]:
    """A small booth with posters, a sloping roof, a counter, a sign."""
    found = [
        box("wall", (0.55, 0.45, 0.62), 0.006).moved((0, 0, 0.62)),
        box("roof", (0.68, 0.58, 0.035), 0.006).moved((0, 0, 1.29), turn(0, -7)),
        box("counter", (0.45, 0.10, 0.025), 0.006).moved((0, -0.53, 0.55)),
        box("step", (0.62, 0.52, 0.05), 0.006).moved((0, 0, 0.05)),
        box("sign", (0.44, 0.03, 0.13), 0.006).moved((0, -0.50, 1.53)),
    ]
    for x in (-0.35, 0.35):
        found.append(rod("pole", (x, -0.50, 1.18), (x, -0.50, 1.46), 0.025))
        found.append(rod("pole", (x, -0.60, 0.10), (x, -0.60, 0.55), 0.02))
    return found


def paint_kiosk(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    boards = step(np.abs(np.mod(z * 9, 1) - 0.5), 0.46, 0.02)
    plank = noise(np.column_stack([np.floor(z * 9) * 7.3, x * 1.5, y * 1.5]), 1.0, 4, 3)
    wall = mix(mix((0.20, 0.34, 0.36), (0.30, 0.44, 0.44), 0.5 + 0.5 * plank), (0.08, 0.12, 0.12), boards)
    rough = 0.62 + 0.1 * plank
    # poster: (axis it faces, side, middle along the wall, height, width, tall, seed)
    for axis, side, at, high, wide, tall, seed in (
        (0, 1, -0.12, 0.68, 0.5, 0.72, 1), (0, 1, 0.29, 0.62, 0.2, 0.5, 2), (0, -1, 0.0, 0.66, 0.72, 0.8, 3),
        (1, 1, -0.24, 0.70, 0.46, 0.7, 4), (1, 1, 0.29, 0.72, 0.40, 0.55, 5), (1, -1, 0.0, 0.86, 0.86, 0.44, 6),
    ):  # fmt: skip
        across, facing = p[:, 1 - axis], n[:, axis] * side > 0.9
        flip = side if axis == 0 else -side
        u, v = 0.5 + flip * (across - at) / wide, 0.5 + (z - high) / tall
        inside = facing & (part == "wall") & (u > 0) & (u < 1) & (v > 0) & (v < 1)
        lines = ("NOTICE " + str(seed), *sentences(seed, 9, 4))
        ink = printed(writing(lines, 1024, int(1024 * tall / wide), 6), u, v)
        paper = np.array([(0.78, 0.74, 0.62), (0.75, 0.62, 0.25), (0.70, 0.72, 0.70)][seed % 3])
        tint = np.array([(0.05, 0.05, 0.06), (0.45, 0.05, 0.04), (0.05, 0.10, 0.35)][seed % 3])
        wall = np.where(inside[:, None], mix(paper * (1 + 0.06 * noise(p, 3, seed)[:, None]), tint, ink), wall)
        rough = np.where(inside, 0.38, rough)
    tiles = step(np.abs(np.mod(x * 8 + 0.5 * (np.floor(y * 7) % 2), 1) - 0.5), 0.44, 0.03)
    tiles = np.maximum(tiles, step(np.abs(np.mod(y * 7, 1) - 0.5), 0.44, 0.03))
    roof = mix(mix((0.38, 0.10, 0.06), (0.50, 0.18, 0.10), 0.5 + 0.5 * noise(p, 4, 8, 2)), (0.14, 0.05, 0.04), tiles)
    fibres = 0.5 + 0.5 * noise(p * [2, 30, 30], 1, 5, 2)
    face = (n[:, 1] < -0.9) | (n[:, 1] > 0.9)
    u = np.where(n[:, 1] < 0, (x + 0.44) / 0.88, (0.44 - x) / 0.88)
    name = printed(writing(("EVENING PRESS",), 1024, 302, 8), u, (z - 1.40) / 0.26) * face
    for which, value, gloss in (
        ("roof", roof, 0.5), ("counter", mix((0.45, 0.28, 0.13), (0.55, 0.36, 0.18), fibres), 0.3),
        ("step", mix((0.30, 0.30, 0.29), (0.40, 0.39, 0.37), 0.5 + 0.5 * noise(p, 14, 6, 3)), 0.8),
        ("sign", mix((0.04, 0.10, 0.07), (0.80, 0.66, 0.20), name), 0.25), ("pole", np.full_like(p, 0.10), 0.35),
    ):  # fmt: skip
        wall = np.where((part == which)[:, None], value, wall)
        rough = np.where(part == which, gloss, rough)
    return wall, rough, np.zeros(len(p))


def grotto() -> list[Solid]:
    """A rock hollowed out from above and from one side, with a step, two pillars and three balls in it."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        rock = block(p, (0, 0, 0), (0.92, 0.80, 0.72), 0.25)
        rock = rock + 0.02 * np.sin(5 * x + 1) * np.sin(6 * y) * np.sin(5 * z + 2)
        rock = carve(rock, block(p, (0, 0, 0.35), (0.68, 0.56, 0.85), 0.16), 0.06)
        rock = carve(rock, ellipsoid(p, (0, -0.8, 0.15), (0.34, 0.5, 0.42)), 0.06)
        rock = blend(rock, block(p, (-0.42, 0.2, -0.38), (0.25, 0.36, 0.14), 0.03), 0.03)
        for x0, y0 in ((0.36, 0.24), (0.40, -0.22)):
            rock = blend(rock, capsule_up(p, x0, y0, -0.5, 0.28, 0.085), 0.05)
        return rock

    return [
        level_set("rock", distance, 1.1, cells=140, faces=22000),
        ball("white", (-0.02, 0.05, -0.33), (0.17, 0.17, 0.17)),
        ball("gloss", (-0.45, 0.28, -0.10), (0.14, 0.14, 0.14)),
        ball("dull", (0.08, -0.30, -0.38), (0.12, 0.12, 0.12)),
    ]  # fmt: skip


def capsule_up(p: np.ndarray, x: float, y: float, low: float, high: float, radius: float) -> np.ndarray:
    """Distance to an upright rod."""
    return np.sqrt(
        (p[..., 0] - x) ** 2 + (p[..., 1] - y) ** 2 + (p[..., 2] - np.clip(p[..., 2], low, high)) ** 2
    ) - radius  # fmt: skip


def paint_grotto(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    stone = mix((0.32, 0.30, 0.27), (0.52, 0.49, 0.44), 0.5 + 0.5 * noise(p, 5, 21, 4))
    inside = (np.abs(x) < 0.72) & (np.abs(y) < 0.60) & (z > -0.53) & (z < 0.66)
    tone = step(np.sin(13 * z + 2 * np.sin(5 * (x + y))), 0, 0.3)
    azimuth = np.arctan2(y, x)
    sector = np.floor((azimuth / (2 * np.pi) + 0.125) * 4) % 4
    walls = np.empty_like(p)
    for k, (a, b) in enumerate(
        (((0.72, 0.10, 0.06), (0.60, 0.04, 0.05)), ((0.70, 0.55, 0.08), (0.75, 0.66, 0.20)),
         ((0.06, 0.36, 0.60), (0.04, 0.24, 0.48)), ((0.10, 0.52, 0.14), (0.20, 0.62, 0.18)))
    ):  # fmt: skip
        walls = np.where((sector == k)[:, None], mix(a, b, tone), walls)
    check = (np.floor(x * 8) + np.floor(y * 8)) % 2
    floor = mix((0.70, 0.68, 0.62), (0.30, 0.29, 0.30), check)
    walls = np.where((n[:, 2] > 0.8)[:, None], floor, walls)
    pillar = (np.hypot(x - 0.36, y - 0.24) < 0.11) | (np.hypot(x - 0.40, y + 0.22) < 0.11)
    walls = np.where(
        (pillar & (n[:, 2] < 0.8))[:, None],
        mix((0.75, 0.74, 0.72), (0.30, 0.14, 0.40), step(np.sin(30 * z), 0.3, 0.2)),
        walls,
    )
    colour = np.where(inside[:, None], walls, stone)
    rough = np.where(inside, 0.55, 0.8)
    stripes = step(np.sin(28 * (z + 0.5 * x)), 0.4, 0.2)
    for name, value, gloss in (
        ("white", mix((0.82, 0.81, 0.78), (0.70, 0.30, 0.08), stripes), 0.45),
        ("gloss", mix((0.55, 0.10, 0.35), (0.80, 0.75, 0.70), stripes), 0.2),
        ("dull", mix((0.12, 0.40, 0.42), (0.75, 0.70, 0.50), stripes), 0.7),
    ):  # fmt: skip
        colour, rough = np.where((part == name)[:, None], value, colour), np.where(part == name, gloss, rough)
    return colour, rough, np.zeros(len(p))


SCENES = {
    "kiosk": Recipe(kiosk, paint_kiosk, ("day", 58), 230, heights=(-0.2, 0.9), texels=2048),
    "grotto": Recipe(grotto, paint_grotto, ("forest", 40), 240, heights=(0.0, 0.97)),
}
