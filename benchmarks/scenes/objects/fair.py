"""Three scenes for choosing: balloons with baskets, a brush with bristles, a cactus with spines."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.paint import coat, mix, noise, step, wood
from benchmarks.scenes.shapes import Solid, ball, box, grid, rod, smooth, tube, turned

BALLOONS = ((-0.62, 0.0, 0.15, 1.0), (0.55, 0.35, 0.0, 0.85), (0.30, -0.62, -0.10, 0.72))


def balloons() -> list[Solid]:
    """Three hot-air balloons, each on a pole above one lawn: glossy skins, baskets on four ropes."""
    found = [box("base", (0.95, 0.85, 0.03), 0.02).moved((-0.05, 0, -1.0))]
    for k, (x, y, z, size) in enumerate(BALLOONS):
        at = np.array([x, y, z])
        skin = turned(
            f"skin {k}", [(0, -0.55), (0.10, -0.55)],
            smooth((0.10, -0.55), (0.25, -0.32), (0.42, 0.0), (0.46, 0.22), (0.36, 0.48), (0.14, 0.62), (0.0, 0.64),
                   count=64), sides=96,
        )  # fmt: skip
        found.append(skin.scaled(size).moved(at))
        half = 0.10 * size
        low = at - np.array([0, 0, 0.82 * size])
        found.append(box(f"basket {k}", (half, half, 0.8 * half), 0.015).moved(low))
        for a in (-1, 1):
            for b in (-1, 1):
                top = at + np.array([0.08 * a * size, 0.08 * b * size, -0.50 * size])
                end = low + half * np.array([0.9 * a, 0.9 * b, 0.7])
                found.append(rod("rope", top, end, 0.009, sides=8))
        found.append(rod("pole", low - [0, 0, 0.05], (x, y, -1.0), 0.022, sides=16))
    return found


def paint_balloons(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    rows: list[tuple] = [("base", mix([0.16, 0.30, 0.10], [0.30, 0.40, 0.14], 0.5 + 0.5 * noise(p, 6, 2, 3)), 0.8, 0)]
    pairs = (([0.70, 0.05, 0.05], [0.80, 0.74, 0.60]), ([0.06, 0.20, 0.55], [0.82, 0.60, 0.06]),
             ([0.10, 0.40, 0.14], [0.75, 0.75, 0.72]))  # fmt: skip
    for k, (x, y, z, size) in enumerate(BALLOONS):
        angle = np.arctan2(p[:, 1] - y, p[:, 0] - x)
        high = (p[:, 2] - z) / size
        wave = (np.sin(8 * angle), np.sin(6 * angle + 14 * high), np.sin(26 * high))[k]
        rows.append((f"skin {k}", mix(*pairs[k], step(wave, 0, 0.12)), (0.15, 0.25, 0.4)[k], 0))
        weave = 0.5 + 0.5 * np.sin(70 * p[:, 2]) * np.sin(40 * angle)
        rows.append((f"basket {k}", mix([0.30, 0.16, 0.06], [0.52, 0.33, 0.15], weave), 0.7, 0))
    return coat(part, (*rows, ("rope", [0.10, 0.08, 0.06], 0.7, 0), ("pole", [0.45, 0.45, 0.48], 0.4, 0)))


def brush() -> list[Solid]:
    """A scrubbing brush lying on its back: a varnished wooden block, a handle with a ring, 336 stiff bristles."""
    rng = np.random.default_rng(12)
    found = [box("wood", (0.62, 0.26, 0.085), 0.06, steps=6)]
    grip = np.array([(0.55, 0, 0), (0.75, 0, 0.03), (1.0, 0, 0.05), (1.25, 0, 0.035), (1.4, 0, 0)])
    share = np.linspace(0, 1, 33)
    line = np.column_stack([np.interp(share, np.linspace(0, 1, 5), along) for along in grip.T])
    found.append(tube("wood", line, 0.085 + 0.03 * np.sin(np.pi * share), sides=24))
    found.append(tube("steel", ring((1.47, 0, 0.0), 0.09, 48), 0.016, closed=True))
    for x in np.linspace(-0.54, 0.54, 14):
        for y in np.linspace(-0.19, 0.19, 6):
            for _ in range(4):
                foot = np.array([x, y, 0.06]) + np.append(rng.uniform(-0.014, 0.014, 2), 0)
                lean = np.array([0.06 * x, 0.16 * y, 0]) + np.append(rng.normal(0, 0.016, 2), 0)
                tip = foot + np.array([0, 0, 0.36 + rng.uniform(-0.015, 0.015)]) + 0.5 * lean
                found.append(rod("bristle", foot, tip, 0.0075, sides=6))
    return found


def paint_brush(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    grain = mix([0.40, 0.20, 0.08], [0.62, 0.38, 0.18], wood(p, 12, axis=0, scale=1.4))
    hair = mix([0.62, 0.52, 0.34], [0.16, 0.10, 0.05], step(p[:, 2], 0.33, 0.08))
    return coat(part, (("wood", grain, 0.25, 0), ("steel", [0.65, 0.64, 0.62], 0.25, 1), ("bristle", hair, 0.6, 0)))


def cactus() -> list[Solid]:
    """A ribbed cactus with an arm and a bloom in a clay pot, hundreds of spines along its ribs."""
    rng = np.random.default_rng(5)
    pot = turned(
        "pot", [(0, 0), (0.30, 0)], [(0.30, 0), (0.40, 0.42)], [(0.40, 0.42), (0.45, 0.42)],
        [(0.45, 0.42), (0.46, 0.56)], [(0.46, 0.56), (0.40, 0.56)], [(0.40, 0.56), (0.39, 0.50)],
        [(0.39, 0.50), (0, 0.50)], sides=80,
    )  # fmt: skip
    found = [pot]
    for middle, wide, tall, low in (((0, 0), 0.30, 1.15, 0.45), ((0.34, 0.08), 0.17, 0.55, 0.92)):
        angle = np.linspace(0, 2 * np.pi, 121)
        rows = np.linspace(0, 1, 49)
        outline = np.sqrt(np.clip(1 - np.clip((rows - 0.62) / 0.38, 0, 1) ** 2, 0, 1)) * (
            0.78 + 0.22 * np.minimum(1, rows / 0.3)
        )
        count = 14 if wide > 0.2 else 10
        rib = 1 - 0.16 * (0.5 - 0.5 * np.cos(count * angle)) ** 0.8
        found.append(_ribbed(middle, wide * outline, low + tall * rows, rib, angle))
        for k in range(count):
            a = 2 * np.pi * k / count
            out = np.array([np.cos(a), np.sin(a), 0])
            for r in range(4, 46, 4):
                at = np.array([*middle, low + tall * rows[r]]) + wide * outline[r] * out
                for _ in range(3):
                    way = out + rng.normal(0, 0.6, 3)
                    way *= rng.uniform(0.06, 0.10) / np.linalg.norm(way)
                    found.append(rod("spine", at - 0.3 * way, at + way, 0.0055, sides=6))
    found.append(tube("flesh", np.array([[0.1, 0.02, 0.98], [0.26, 0.06, 0.93], [0.34, 0.08, 1.0]]), 0.10, sides=24))
    for k in range(7):
        a = 2 * np.pi * k / 7
        found.append(ball("bloom", (0.09 * np.cos(a), 0.09 * np.sin(a), 1.62), (0.055, 0.055, 0.06), sides=24))
    return [*found, ball("heart", (0, 0, 1.62), (0.06, 0.06, 0.06), sides=24)]


def _ribbed(middle: tuple, radii: np.ndarray, heights: np.ndarray, rib: np.ndarray, angle: np.ndarray) -> Solid:
    """A closed body whose outline at each height is the ribbed circle."""
    radii = np.maximum(radii, 0.012)
    flat = np.stack([np.cos(angle), np.sin(angle)], -1) * rib[:, None]
    flat[-1] = flat[0]
    points = np.concatenate(
        [
            radii[:, None, None] * flat + np.asarray(middle),
            np.broadcast_to(heights[:, None, None], (len(radii), len(angle), 1)),
        ],
        -1,
    )
    rows = [np.concatenate([np.broadcast_to([*middle, heights[k]], (1, len(angle), 3)), points[[k]]]) for k in (0, -1)]
    across = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    across[:, [0, -1]] = across[:, [1]] + across[:, [-2]]
    across /= np.linalg.norm(across, axis=-1, keepdims=True).clip(1e-12)
    ends = [
        grid(row, np.broadcast_to([0, 0, s], row.shape).astype(float)) for row, s in zip(rows, (-1, 1), strict=True)
    ]
    return Solid("flesh", (grid(points, across), *ends))


def paint_cactus(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    green = mix([0.06, 0.20, 0.08], [0.16, 0.34, 0.14], 0.5 + 0.5 * noise(p, 5, 3, 3))
    clay = mix([0.50, 0.20, 0.10], [0.62, 0.30, 0.17], 0.5 + 0.5 * noise(p, 7, 8, 3))
    earth = mix([0.06, 0.04, 0.03], [0.30, 0.26, 0.20], step(noise(p, 30, 5, 2), 0.1, 0.2))
    inside = (np.hypot(p[:, 0], p[:, 1]) < 0.395) & (p[:, 2] > 0.45)
    return coat(part, (
        ("pot", np.where(inside[:, None], earth, clay), 0.8, 0), ("flesh", green, 0.4, 0),
        ("spine", [0.66, 0.60, 0.44], 0.5, 0), ("bloom", [0.78, 0.16, 0.40], 0.5, 0),
        ("heart", [0.80, 0.66, 0.10], 0.6, 0),
    ))  # fmt: skip


SCENES = {
    "balloons": Recipe(balloons, paint_balloons, ("day", 5), 590, heights=(-0.5, 0.9)),
    "brush": Recipe(brush, paint_brush, ("interior", 12), 600, heights=(-0.2, 0.92)),
    "cactus": Recipe(cactus, paint_cactus, ("courtyard", 8), 610, heights=(-0.2, 0.9)),
}
