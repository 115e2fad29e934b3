"""Three small scenes for choosing (256 pixels) that have much of one thing: objects apart, metal, small parts."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.paint import coat, mix, noise, step
from benchmarks.scenes.shapes import Solid, ball, box, rod, smooth, tube, turn, turned


def marbles() -> list[Solid]:
    """Seven balls that touch nothing, one around six; photographed from above only."""
    found = [ball("ball6", (0, 0, 0.02), (0.34, 0.34, 0.34), sides=64)]
    for k in range(6):
        angle, radius = k * np.pi / 3, (0.24, 0.28, 0.22)[k % 3]
        middle = (0.76 * np.cos(angle), 0.76 * np.sin(angle), radius - 0.3)
        found.append(ball(f"ball{k}", middle, (radius,) * 3, sides=56))
    return found


def paint_marbles(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    clouds = step(noise(p, 5, 6, 3), 0.0, 0.15)
    checks = step(np.sin(p[:, 0] * 22) * np.sin(p[:, 1] * 22) * np.sin(p[:, 2] * 22 + 1), 0.0, 0.05)
    return coat(part, (
        ("ball0", [0.55, 0.05, 0.04], 0.12, 0),
        ("ball1", mix([0.75, 0.72, 0.66], [0.08, 0.20, 0.42], checks), 0.5, 0),
        ("ball2", [0.80, 0.58, 0.25], 0.25, 1),
        ("ball3", [0.03, 0.03, 0.03], 0.6, 0),
        ("ball4", mix([0.10, 0.32, 0.14], [0.55, 0.60, 0.30], clouds), 0.2, 0),
        ("ball5", [0.62, 0.58, 0.52], 0.85, 0),
        ("ball6", [0.72, 0.71, 0.69], 0.10, 1),
    ))  # fmt: skip


def trophy() -> list[Solid]:
    """A cup all of metal but its plinth: silver bowl with gilded bands and handles, closed by a domed lid."""
    bowl = turned(
        "bowl",
        [(0.0, -0.62), (0.30, -0.62)],
        smooth((0.30, -0.62), (0.28, -0.55), (0.09, -0.42), (0.08, -0.25), (0.16, -0.16), (0.42, 0.10), (0.50, 0.42),
               (0.52, 0.55)),
        [(0.52, 0.55), (0.50, 0.57)],
        smooth((0.50, 0.57), (0.40, 0.70), (0.18, 0.78), (0.06, 0.80)),
        [(0.06, 0.80), (0.0, 0.80)],
        sides=96,
    )  # fmt: skip
    found = [
        bowl,
        ball("gilt", (0, 0, 0.85), (0.09, 0.09, 0.11)),
        box("plinth", (0.34, 0.34, 0.13), 0.02).moved((0, 0, -0.74)),
    ]
    found.append(tube("gilt", ring((0, 0, 0.44), 0.505, 72), 0.025, closed=True))
    found.append(tube("gilt", ring((0, 0, -0.30), 0.10, 48), 0.035, closed=True))
    for side in (-1, 1):
        path = [(0.46, 0.36), (0.66, 0.46), (0.80, 0.34), (0.76, 0.12), (0.58, -0.02), (0.36, 0.0)]
        fine = np.array(smooth(*[(k, x) for k, (x, _) in enumerate(path)], count=40))[:, 1]
        high = np.array(smooth(*[(k, z) for k, (_, z) in enumerate(path)], count=40))[:, 1]
        found.append(tube("gilt", np.column_stack([side * fine, 0 * fine, high]), 0.035))
    return found


def paint_trophy(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    angle = np.arctan2(p[:, 1], p[:, 0])
    flutes = step(np.sin(angle * 16), 0.2, 0.1) * (p[:, 2] > -0.1) * (p[:, 2] < 0.36)
    base = np.broadcast_to([0.86, 0.84, 0.80], p.shape).copy()
    rough, metal = 0.14 + 0.16 * flutes, np.ones(len(p))
    gilt, plinth = part == "gilt", part == "plinth"
    base[gilt], rough[gilt] = (0.85, 0.62, 0.28), 0.2
    grain = mix([0.10, 0.05, 0.025], [0.20, 0.10, 0.05], 0.5 + 0.5 * noise(p * [2, 2, 18], 2, 5, 3))
    base[plinth], rough[plinth], metal[plinth] = grain[plinth], 0.3, 0
    return base, rough, metal


def digger() -> list[Solid]:
    """A machine of studded bricks: chassis on tracks, a cab, an arm of beams with a shovel."""
    found: list[Solid] = []

    def brick(name: str, at: tuple, size: tuple, studs: tuple[int, int] = (0, 0)) -> None:
        half = [s / 2 for s in size]
        found.append(box(name, half, 0.008, steps=2).moved(at))
        for i in range(studs[0]):
            for j in range(studs[1]):
                x = at[0] + ((i + 0.5) / studs[0] - 0.5) * size[0]
                y = at[1] + ((j + 0.5) / studs[1] - 0.5) * size[1]
                top = at[2] + half[2]
                found.append(rod("stud_" + name, (x, y, top - 0.02), (x, y, top + 0.035), 0.035, sides=18))

    for y in (-0.36, 0.36):
        brick("track", (0, y, -0.5), (1.3, 0.22, 0.22))
        for x in np.linspace(-0.55, 0.55, 12):
            brick("track", (x, y, -0.5), (0.06, 0.24, 0.26))
        for x in (-0.5, 0.0, 0.5):
            found.append(rod("hub", (x, y - 0.14, -0.5), (x, y + 0.14, -0.5), 0.08, sides=24))
    brick("grey", (0, 0, -0.36), (1.1, 0.56, 0.10), (9, 5))
    brick("yellow", (-0.22, 0, -0.22), (0.6, 0.5, 0.16), (5, 4))
    brick("yellow", (-0.40, 0, -0.06), (0.24, 0.5, 0.16), (2, 4))
    brick("cab", (-0.12, 0, 0.06), (0.26, 0.36, 0.40))
    brick("yellow", (-0.12, 0, 0.29), (0.32, 0.42, 0.06), (3, 4))
    for y in (-0.12, 0.12):
        arm = box("yellow", (0.36, 0.035, 0.05), 0.008).moved((0.34, y, 0.02), turn(1, -32))
        fore = box("yellow", (0.30, 0.03, 0.045), 0.008).moved((0.82, y, 0.02), turn(1, 50))
        found += [arm, fore]
    for x, z in ((0.06, -0.16), (0.62, 0.20), (0.98, -0.18)):
        found.append(rod("hub", (x, -0.18, z), (x, 0.18, z), 0.05, sides=24))
    brick("shovel", (1.04, 0, -0.36), (0.05, 0.7, 0.30))
    brick("shovel", (0.97, 0, -0.50), (0.20, 0.7, 0.04))
    found.append(rod("lamp", (-0.2, -0.14, 0.30), (-0.2, -0.14, 0.42), 0.04, sides=20))
    return found


def paint_digger(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    bricks = np.array([name.removeprefix("stud_") for name in part])
    base, rough, metal = coat(bricks, (
        ("track", (0.05, 0.05, 0.055), 0.5, 0), ("hub", (0.55, 0.54, 0.52), 0.35, 1),
        ("grey", (0.25, 0.26, 0.27), 0.3, 0), ("yellow", (0.72, 0.44, 0.05), 0.28, 0),
        ("cab", (0.06, 0.09, 0.12), 0.15, 0), ("shovel", (0.35, 0.36, 0.36), 0.35, 0),
        ("lamp", (0.80, 0.25, 0.04), 0.2, 0),
    ))  # fmt: skip
    return base * (1 + 0.06 * noise(p, 8, 3, 2))[:, None], rough, metal


SCENES = {
    "marbles": Recipe(marbles, paint_marbles, ("courtyard", 30), 430, heights=(0.08, 0.95)),
    "trophy": Recipe(trophy, paint_trophy, ("interior", 60), 440, heights=(-0.25, 0.9)),
    "digger": Recipe(digger, paint_digger, ("sunset", 40), 450, heights=(0.0, 0.95)),
}
