"""As people take pictures: an object on a table, without masks; a jug while light and camera settings wander."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import mix, noise, step, wood
from benchmarks.scenes.shapes import (
    Solid,
    ball,
    blend,
    box,
    capsule,
    ellipsoid,
    level_set,
    rod,
    smooth,
    tube,
    turn,
    turned,
)


def table(radius: float) -> Solid:
    """A round table top, its upper side at z = 0."""
    return turned(
        "table", [(0, -0.08), (radius - 0.03, -0.08)], smooth((radius - 0.03, -0.08), (radius, -0.05), (radius, -0.02)),
        smooth((radius, -0.02), (radius - 0.005, -0.005), (radius - 0.02, 0.0), count=6),
        [(radius - 0.02, 0), (0.8, 0), (0, 0)],
        sides=120,
    )  # fmt: skip


def desk() -> list[Solid]:
    """A wooden engine with six wheels on a wooden table."""
    found = [table(1.15), box("frame", (0.62, 0.17, 0.05), 0.02).moved((0, 0, 0.24))]
    along = turn(1, 90)
    boiler = turned(
        "boiler",
        [(0, 0), (0.17, 0)],
        smooth((0.17, 0), (0.20, 0.03), (0.20, 0.06)),
        [(0.20, 0.06), (0.20, 0.75)],
        [(0.20, 0.75), (0, 0.75)],
        sides=48,
    )
    found.append(boiler.moved((-0.60, 0, 0.47), along))
    found.append(box("cab", (0.20, 0.23, 0.30), 0.02).moved((0.36, 0, 0.57)))
    found.append(box("roof", (0.26, 0.28, 0.03), 0.02).moved((0.36, 0, 0.90)))
    stack = turned(
        "stack",
        [(0, 0), (0.065, 0)],
        [(0.065, 0), (0.065, 0.2)],
        smooth((0.065, 0.2), (0.11, 0.29), (0.11, 0.33)),
        [(0.11, 0.33), (0, 0.33)],
    )
    found += [stack.moved((-0.44, 0, 0.62)), ball("dome", (-0.12, 0, 0.66), (0.1, 0.1, 0.12))]
    across = turn(0, 90)
    for x, radius in ((-0.45, 0.13), (-0.12, 0.13), (0.36, 0.19)):
        for side in (-1, 1):
            wheel = turned(
                "wheel",
                [(0, -0.03), (radius - 0.01, -0.03)],
                smooth((radius - 0.01, -0.03), (radius, -0.02), (radius, 0.02), (radius - 0.01, 0.03)),
                [(radius - 0.01, 0.03), (0, 0.03)],
                sides=48,
            )
            found.append(wheel.moved((x, 0.21 * side, radius + 0.001), across))
        found.append(rod("axle", (x, -0.27, radius), (x, 0.27, radius), 0.025))
    return found


def planks(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours [N, 3] of a table top of planks, and their grain [N]."""
    x, y, z = p.T
    plank = np.floor(x * 4 + 0.5)
    grain = wood(np.column_stack([x - plank * 0.25 + 0.37 * plank, y, z]), 13, axis=1, scale=1.3)
    top = mix((0.24, 0.13, 0.07), (0.46, 0.28, 0.15), np.clip(grain + 0.25 * np.sin(5 * plank), 0, 1))
    return mix(top, (0.08, 0.05, 0.03), step(np.abs(np.mod(x * 4 + 0.5, 1) - 0.5), 0.485, 0.01)), grain


def paint_desk(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    top, grain = planks(p)
    fine = wood(p, 17, axis=0, scale=2.2)
    colours = {
        "frame": ((0.45, 0.30, 0.16), (0.60, 0.42, 0.24)), "boiler": ((0.05, 0.24, 0.30), (0.07, 0.32, 0.38)),
        "cab": ((0.62, 0.08, 0.05), (0.70, 0.13, 0.08)), "roof": ((0.10, 0.10, 0.11), (0.15, 0.14, 0.14)),
        "stack": ((0.12, 0.11, 0.10), (0.18, 0.16, 0.14)), "dome": ((0.75, 0.55, 0.08), (0.80, 0.62, 0.15)),
        "wheel": ((0.62, 0.45, 0.10), (0.72, 0.55, 0.16)), "axle": ((0.3, 0.2, 0.12), (0.4, 0.28, 0.17)),
    }  # fmt: skip
    colour, rough = top, 0.35 + 0.2 * grain
    for name, (a, b) in colours.items():
        mine = part == name
        colour = np.where(mine[:, None], mix(a, b, fine), colour)
        rough = np.where(mine, 0.45 if name != "boiler" else 0.28, rough)
    window = (part == "cab") & (np.abs(x - 0.36) < 0.11) & (np.abs(z - 0.68) < 0.10) & (np.abs(y) > 0.2)
    number = (part == "cab") & (np.abs(np.abs(x - 0.36) - 0.05) < 0.018) & (np.abs(z - 0.42) < 0.09) & (np.abs(y) > 0.2)
    bands = (part == "boiler") & (np.abs(np.mod(x, 0.19) - 0.1) < 0.012)
    colour = np.where(
        (window | number)[:, None], (0.78, 0.74, 0.62), np.where(bands[:, None], (0.75, 0.60, 0.16), colour)
    )
    spokes = (part == "wheel") & (np.abs(y) > 0.235)
    for cx, r in ((-0.45, 0.13), (-0.12, 0.13), (0.36, 0.19)):
        far = np.hypot(x - cx, z - r)
        angle = np.arctan2(z - r, x - cx)
        dark = spokes & (far < 0.78 * r) & (far > 0.3 * r) & (np.cos(8 * angle) < 0.3)
        colour = np.where(dark[:, None], (0.20, 0.06, 0.04), colour)
    return colour, rough, np.zeros(len(p))


def duck() -> list[Solid]:
    """A painted decoy on a wooden table."""

    def distance(p: np.ndarray) -> np.ndarray:
        body = ellipsoid(p, (0, 0, 0.30), (0.62, 0.36, 0.33))
        body = blend(body, capsule(p, (-0.46, 0, 0.40), (-0.74, 0, 0.58), 0.07), 0.16)
        for side in (-1, 1):
            body = blend(body, ellipsoid(p, (-0.08, 0.31 * side, 0.38), (0.40, 0.10, 0.19)), 0.03)
        neck = capsule(p, (0.40, 0, 0.42), (0.46, 0, 0.82), 0.15)
        head = blend(ellipsoid(p, (0.48, 0, 0.92), (0.24, 0.19, 0.20)), neck, 0.08)
        bill = ellipsoid(p, (0.74, 0, 0.86), (0.16, 0.10, 0.045))
        return np.maximum(blend(blend(body, head, 0.10), bill, 0.04), -p[..., 2] - 0.02)

    return [table(1.15), level_set("duck", distance, 1.25, cells=170, faces=24000)]


def paint_duck(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    top, grain = planks(p)
    feather = 0.5 + 0.5 * np.sin(70 * x + 9 * noise(p, 5, 3, 2)) * np.sin(55 * z + 6 * noise(p, 6, 4, 2))
    colour = mix((0.34, 0.33, 0.31), (0.62, 0.60, 0.56), feather)
    wing = (((x + 0.08) / 0.42) ** 2 + ((z - 0.38) / 0.20) ** 2 < 1) & (np.abs(y) > 0.27)
    rows = step(np.sin(46 * z + 14 * x), 0, 0.4) * step(np.sin(60 * x), -0.6, 0.3)
    colour = np.where(wing[:, None], mix((0.20, 0.13, 0.08), (0.42, 0.30, 0.18), rows), colour)
    mirror = wing & (np.abs(z - 0.33 - 0.1 * x) < 0.045) & (x < 0.0)
    colour = np.where(mirror[:, None], (0.07, 0.12, 0.42), colour)
    breast = step(x + 0.6 * (z - 0.35), 0.36, 0.06)
    speckle = step(noise(p, 30, 8, 2), 0.1, 0.2)
    colour = mix(colour, mix((0.26, 0.11, 0.06), (0.40, 0.20, 0.11), speckle), breast)
    tail = step(-x, 0.52, 0.05)
    colour = mix(colour, mix((0.72, 0.69, 0.62), (0.16, 0.14, 0.12), step(np.sin(45 * y + 20 * z), 0.2, 0.2)), tail)
    head = (z > 0.60) & (x > 0.2)
    green = mix((0.02, 0.16, 0.08), (0.05, 0.28, 0.16), 0.5 + 0.5 * noise(p, 12, 9, 3))
    colour = np.where(head[:, None], green, colour)
    ring_ = (np.abs(z - 0.62 + 0.015 * np.sin(9 * np.arctan2(y, x - 0.43))) < 0.028) & (x > 0.2)
    colour = np.where(ring_[:, None], (0.80, 0.78, 0.72), colour)
    bill = (x > 0.655) & (z > 0.7)
    colour = np.where(
        bill[:, None], mix((0.55, 0.42, 0.06), (0.70, 0.58, 0.12), 0.5 + 0.5 * noise(p, 16, 2, 2)), colour
    )
    eye = np.hypot(x - 0.56, z - 0.97) < 0.03
    colour = np.where((eye & head)[:, None], (0.02, 0.02, 0.02), colour)
    mine = part == "duck"
    rough = np.where(head & ~bill, 0.25, np.where(wing, 0.45, 0.6))
    return np.where(mine[:, None], colour, top), np.where(mine, rough, 0.35 + 0.2 * grain), np.zeros(len(p))


def still() -> list[Solid]:
    """A teapot on a checked cloth."""
    pot = turned(
        "pot", [(0, 0.0), (0.30, 0.0)],
        smooth((0.30, 0), (0.34, 0.03), (0.50, 0.26), (0.47, 0.52), (0.30, 0.68), (0.26, 0.70), count=44),
        smooth((0.26, 0.70), (0.25, 0.73), (0.14, 0.79), (0.05, 0.81)),
        smooth((0.05, 0.81), (0.045, 0.84), (0.075, 0.88), (0.06, 0.92), (0, 0.935)),
        sides=96,
    )  # fmt: skip
    spout = curve([(0.36, 0, 0.22), (0.56, 0, 0.27), (0.68, 0, 0.46), (0.80, 0, 0.64)], 24)
    handle = curve([(-0.42, 0, 0.56), (-0.62, 0, 0.62), (-0.76, 0, 0.46), (-0.66, 0, 0.26), (-0.44, 0, 0.22)], 32)
    return [
        table(1.15),
        pot,
        tube("spout", spout, np.linspace(0.115, 0.05, 24), sides=24),
        tube("handle", handle, 0.042),
    ]


def paint_still(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    thread = 0.5 + 0.5 * np.sin(190 * x) * np.sin(190 * y)
    a, b = step(np.sin(14 * x), 0.0, 0.15), step(np.sin(14 * y), 0.0, 0.15)
    cloth = mix((0.74, 0.70, 0.62), (0.12, 0.20, 0.42), 0.5 * (a + b)) * (0.85 + 0.15 * thread[:, None])
    cloth = mix(cloth, (0.65, 0.14, 0.10), step(np.sin(42 * x + 1) * np.sin(42 * y), 0.93, 0.03))
    angle = np.arctan2(y, x)
    glaze = mix((0.10, 0.26, 0.24), (0.24, 0.42, 0.36), 0.5 + 0.5 * noise(p, 4, 6, 4))
    flower = np.cos(6 * angle) * 0.05 + 0.10 * np.cos(
        5 * np.arctan2(z - 0.36 - 0.02 * np.sin(3 * angle), np.sin(6 * angle) * 0.08)
    )
    glaze = mix(glaze, (0.72, 0.62, 0.42), step(flower, 0.055, 0.02) * (np.abs(z - 0.36) < 0.13))
    glaze = mix(glaze, (0.70, 0.40, 0.12), 1 - step(np.abs(z - 0.60), 0.018, 0.006))
    drip = step(z - 0.10 - 0.04 * noise(np.column_stack([angle * 2, z * 0, z * 0]), 2, 9, 2), 0, 0.02)
    glaze = mix((0.42, 0.30, 0.20), glaze, drip)
    glossy = mix(0.6, 0.2, drip)
    colour = np.where(
        (part == "table")[:, None], cloth, np.where((part == "handle")[:, None], (0.28, 0.15, 0.07), glaze)
    )
    return colour, np.where(part == "table", 0.7, np.where(part == "handle", 0.5, glossy)), np.zeros(len(p))


def jug() -> list[Solid]:
    """A jug with a wide mouth, painted, with a handle and a foot."""
    body = turned(
        "jug", [(0, 0), (0.28, 0)], smooth((0.28, 0), (0.30, 0.03), (0.24, 0.09), (0.26, 0.14)),
        smooth((0.26, 0.14), (0.46, 0.42), (0.50, 0.66), (0.36, 0.96), (0.27, 1.10), count=40),
        smooth((0.27, 1.10), (0.28, 1.22), (0.37, 1.36)),
        [(0.37, 1.36), (0.345, 1.37)], smooth((0.345, 1.37), (0.25, 1.22), (0.235, 1.08), (0.24, 1.0)),
        [(0.24, 1.0), (0.1, 0.98), (0, 0.98)],
        sides=96,
    )  # fmt: skip
    handle = curve([(-0.33, 0, 1.27), (-0.58, 0, 1.30), (-0.72, 0, 1.02), (-0.66, 0, 0.74), (-0.46, 0, 0.62)], 36)
    return [body, tube("handle", handle, 0.052), tube("ring", ring((0, 0, 1.10), 0.275, 64), 0.02, closed=True)]


def paint_jug(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    angle = np.arctan2(y, x)
    clay = mix((0.62, 0.44, 0.28), (0.72, 0.56, 0.38), 0.5 + 0.5 * noise(p, 6, 2, 4))
    key = np.mod(angle / (2 * np.pi) * 24, 1)
    band = (np.abs(z - 0.86) < 0.06) & (
        (np.abs(z - 0.86) > 0.045) | (np.abs(key - 0.5) > 0.35) | ((np.abs(key - 0.4) < 0.06) & (z < 0.88))
    )
    wave = np.abs(z - 0.30 - 0.05 * np.sin(10 * angle)) < 0.022
    fish = np.mod(angle / (2 * np.pi) * 5, 1) - 0.5
    shape = (np.abs(z - 0.58) < 0.10 * np.sqrt(np.clip(1 - (fish / 0.3) ** 2, 0, 1))) | (
        (fish > 0.27) & (fish < 0.42) & (np.abs(z - 0.58) < 0.6 * (fish - 0.25))
    )
    scale = step(np.sin(70 * z) * np.sin(110 * fish), 0.1, 0.3)
    colour = np.where((band | wave)[:, None], (0.08, 0.06, 0.07), clay)
    colour = np.where(shape[:, None], mix((0.14, 0.26, 0.42), (0.55, 0.60, 0.58), scale), colour)
    colour = np.where(
        ((z > 1.10) & (part == "jug"))[:, None],
        mix((0.30, 0.08, 0.05), (0.42, 0.14, 0.08), 0.5 + 0.5 * noise(p, 9, 5, 3)),
        colour,
    )
    colour = np.where(
        np.isin(part, ("handle", "ring"))[:, None],
        mix((0.08, 0.06, 0.07), (0.62, 0.44, 0.28), step(np.sin(34 * z), 0.5, 0.2)),
        colour,
    )
    return colour, np.where(shape, 0.3, 0.5 + 0.1 * noise(p, 6, 2, 2)), np.zeros(len(p))


SCENES = {
    "desk": Recipe(desk, paint_desk, ("courtyard", 120), 130, heights=(0.18, 0.85), ground=("table",), level=5.0),
    "duck": Recipe(duck, paint_duck, ("courtyard", 60), 140, heights=(0.15, 0.85), ground=("table",), level=5.0),
    "still": Recipe(still, paint_still, ("city", 400), 250, heights=(0.18, 0.85), ground=("table",)),
    "jug": Recipe(jug, paint_jug, ("day", 91), 260, heights=(-0.3, 0.9), wander=True),
}
