"""Four scenes for choosing: a fern, a microphone, a clock, and fruit on a cloth without masks."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.objects.tables import table
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import coat, mix, noise, printed, step, wood, writing
from benchmarks.scenes.shapes import Solid, ball, box, leaf, rod, smooth, tube, turn, turned


def fern() -> list[Solid]:
    """Fourteen arching fronds of nine pairs of leaflets, and four flowers, in a square glazed pot."""
    rng = np.random.default_rng(31)
    found = [
        box("pot", (0.30, 0.30, 0.24), 0.03).moved((0, 0, 0.24)),
        box("soil", (0.26, 0.26, 0.03), 0.01).moved((0, 0, 0.475)),
    ]
    for frond in range(14):
        azimuth = frond * 137.5 + rng.uniform(-10, 10)
        reach, tall = rng.uniform(0.55, 0.95), rng.uniform(0.45, 0.85)
        out = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0])
        share = np.linspace(0, 1, 31)[:, None]
        path = 0.05 * out + reach * share**1.3 * out + [0, 0, 0.46] + [0, 0, tall] * (1.9 * share - 1.5 * share**2.4)
        found.append(tube("stem", path, np.linspace(0.013, 0.005, 31), sides=8))
        tone = rng.uniform()
        for k in range(9):
            at = path[6 + int(2.7 * k)]
            tangent = path[7 + int(2.7 * k)] - path[5 + int(2.7 * k)]
            pitch = np.degrees(np.arctan2(tangent[2], np.linalg.norm(tangent[:2])))
            size = (0.30 - 0.018 * k) * rng.uniform(0.9, 1.1)
            for side in (-1, 1):
                blade = leaf("leaf", size, 0.17 * size, 0.005, rng.uniform(0.2, 0.6))
                heading = turn(2, azimuth) @ turn(1, -pitch) @ turn(2, 62 * side) @ turn(0, rng.uniform(-12, 12))
                found.append(blade.moved(at, heading, name=f"leaf {tone:.3f}"))
    for k in range(4):
        azimuth = 90 * k + 30
        out = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0])
        tip = 0.22 * out + np.array([0, 0, 1.15 + 0.07 * k])
        found.append(
            tube(
                "stem",
                curve([(0.03 * out[0], 0.03 * out[1], 0.46), tuple(0.10 * out + [0, 0, 0.85]), tuple(tip)]),
                0.011,
                sides=8,
            )
        )
        found.append(ball("heart", tip, (0.035, 0.035, 0.03), sides=20))
        for petal in range(6):
            blade = leaf("petal", 0.15, 0.05, 0.006, 0.7)
            found.append(blade.moved(tip, turn(2, 60 * petal) @ turn(1, -25)))
    return found


def paint_fern(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    glaze = mix([0.06, 0.16, 0.30], [0.20, 0.34, 0.46], 0.5 + 0.5 * noise(p, 5, 3, 3))
    glaze = mix([0.70, 0.66, 0.56], glaze, step(np.abs(p[:, 2] - 0.36), 0.035, 0.01))
    names, which = np.unique(part, return_inverse=True)
    tone = np.array([float(name.split()[1]) if name.startswith("leaf ") else 0.5 for name in names])[which]
    green = mix([0.05, 0.17, 0.03], [0.24, 0.36, 0.08], np.clip(tone + 0.3 * noise(p, 12, 8, 2), 0, 1))
    soil = mix([0.05, 0.03, 0.02], [0.16, 0.10, 0.06], 0.5 + 0.5 * noise(p, 30, 6, 2))
    base, rough, metal = coat(part, (
        ("pot", glaze, 0.18, 0), ("soil", soil, 0.9, 0),
        ("stem", [0.24, 0.22, 0.08], 0.5, 0), ("heart", [0.75, 0.55, 0.08], 0.8, 0),
        ("petal", mix([0.72, 0.20, 0.30], [0.80, 0.60, 0.62], 0.5 + 0.5 * noise(p, 25, 4, 1)), 0.6, 0),
    ))  # fmt: skip
    leafy = np.char.startswith(part, "leaf ")
    base[leafy], rough[leafy] = green[leafy], 0.4
    return base, rough, metal


def mic() -> list[Solid]:
    """A ball of wires about dark foam on a lacquered body with a steel collar; a cable, and a stand on three feet."""
    middle, radius = np.array([0.0, 0.0, 0.86]), 0.34
    found = [ball("foam", middle, (0.27, 0.27, 0.27), sides=48)]
    for k in range(14):
        angle = np.linspace(-78, 78, 41) * np.pi / 180
        turned_ = turn(2, 360 / 14 * k)
        line = middle + radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1) @ turned_.T
        found.append(tube("wire", line, 0.011, sides=8))
    for height in np.linspace(-0.28, 0.28, 8):
        found.append(
            tube(
                "wire",
                ring((0, 0, middle[2] + height), np.sqrt(radius**2 - height**2), 72),
                0.011,
                sides=8,
                closed=True,
            )
        )
    found.append(tube("collar", ring(middle, radius + 0.005, 72), 0.028, closed=True))
    cap = turned(
        "collar", [(0, 0.325), (0.10, 0.315)], [(0.10, 0.315), (0.10, 0.335)], [(0.10, 0.335), (0, 0.345)], sides=48
    )
    found.append(cap.moved(middle))
    body = turned(
        "body", [(0, -0.62), (0.10, -0.62)], smooth((0.10, -0.62), (0.12, -0.35), (0.17, 0.10), (0.20, 0.40)),
        smooth((0.20, 0.40), (0.25, 0.47), (0.25, 0.56)), [(0.25, 0.56), (0, 0.56)], sides=72,
    )  # fmt: skip
    found += [body, box("switch", (0.03, 0.02, 0.07), 0.01).moved((0.175, 0, 0.12))]
    found.append(tube("collar", ring((0, 0, -0.58), 0.107, 48), 0.018, closed=True))
    cable = [
        (0, 0, -0.60),
        (0.02, 0.0, -0.75),
        (0.18, 0.10, -0.88),
        (0.45, 0.0, -0.86),
        (0.52, -0.3, -0.84),
        (0.2, -0.55, -0.86),
        (-0.3, -0.5, -0.87),
        (-0.6, -0.2, -0.88),
    ]
    found.append(tube("cable", curve(cable, 90), 0.026, sides=12))
    found.append(tube("clip", ring((0, 0, -0.25), 0.145, 56), 0.03, closed=True))
    for k in range(3):
        out = turn(2, 120 * k + 50) @ np.array([1.0, 0, 0])
        found.append(
            tube(
                "leg",
                np.array([0.14 * out + [0, 0, -0.25], 0.42 * out + [0, 0, -0.5], 0.62 * out + [0, 0, -0.9]]),
                0.028,
            )
        )
        found.append(ball("foot", 0.62 * out + [0, 0, -0.9], (0.05, 0.05, 0.04), sides=24))
    return found


def paint_mic(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    stripes = step(np.abs(p[:, 2] - 0.02), 0.05, 0.006)
    body = mix([0.75, 0.68, 0.20], mix([0.05, 0.06, 0.09], [0.09, 0.10, 0.13], 0.5 + 0.5 * noise(p, 6, 3, 2)), stripes)
    return coat(part, (
        ("foam", [0.03, 0.03, 0.03], 0.95, 0), ("wire", [0.62, 0.62, 0.64], 0.3, 1),
        ("collar", [0.78, 0.77, 0.74], 0.2, 1), ("body", body, 0.22, 0), ("switch", [0.60, 0.05, 0.04], 0.35, 0),
        ("cable", [0.05, 0.05, 0.055], 0.6, 0), ("clip", [0.10, 0.10, 0.10], 0.5, 0),
        ("leg", [0.35, 0.36, 0.40], 0.45, 0), ("foot", [0.08, 0.08, 0.08], 0.8, 0),
    ))  # fmt: skip


def clock() -> list[Solid]:
    """A clock in a varnished case: flat walls of wood, a brass rim, a white dial with figures, brass feet."""
    found = [
        box("case", (0.62, 0.22, 0.58), 0.015).moved((0, 0, 0.62)),
        box("plinth", (0.74, 0.30, 0.06), 0.012).moved((0, 0, 0.05)),
        box("top", (0.70, 0.27, 0.05), 0.02).moved((0, 0, 1.24)),
        box("gable", (0.40, 0.18, 0.07), 0.02).moved((0, 0, 1.35)),
    ]
    face = turned(
        "dial", [(0, -0.02), (0.46, -0.02)], [(0.46, -0.02), (0.46, 0.02)], [(0.46, 0.02), (0, 0.02)], sides=96
    )
    found.append(face.moved((0, -0.215, 0.66), turn(0, 90)))
    rim = np.stack(
        [
            0.46 * np.cos(np.linspace(0, 2 * np.pi, 81)[:-1]),
            np.full(80, -0.235),
            0.66 + 0.46 * np.sin(np.linspace(0, 2 * np.pi, 81)[:-1]),
        ],
        -1,
    )
    found.append(tube("brass", rim, 0.035, closed=True))
    for angle, long, wide in ((60, 0.26, 0.016), (-155, 0.36, 0.011)):
        tip = np.array([np.sin(np.radians(angle)) * long, -0.25, 0.66 + np.cos(np.radians(angle)) * long])
        found.append(rod("hand", (0, -0.25, 0.66), tip, wide, sides=10))
    found.append(ball("brass", (0, -0.25, 0.66), (0.035, 0.03, 0.035), sides=24))
    for x in (-0.55, 0.55):
        for y in (-0.2, 0.2):
            found.append(ball("brass", (x, y, -0.03), (0.06, 0.06, 0.05), sides=28))
        found.append(
            tube(
                "brass",
                np.array(
                    [[x * 1.13, -0.10, 1.0], [x * 1.23, -0.08, 0.93], [x * 1.23, 0.08, 0.93], [x * 1.13, 0.10, 1.0]]
                ),
                0.02,
            )
        )
    return found


def paint_clock(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    grain = wood(p, 23, axis=2, scale=1.3)
    oak = mix([0.20, 0.07, 0.03], [0.42, 0.19, 0.08], grain)
    inlay = (np.abs(np.maximum(np.abs(p[:, 0]) / 0.56, np.abs(p[:, 2] - 0.62) / 0.52) - 0.985) < 0.012) & (
        part == "case"
    )
    oak = np.where(inlay[:, None], [0.66, 0.52, 0.30], oak)
    x, z = p[:, 0], p[:, 2] - 0.66
    white = np.broadcast_to(np.array([0.78, 0.75, 0.68]), p.shape).copy()
    radius, angle = np.hypot(x, z), np.arctan2(x, z)
    minute = np.abs(np.mod(angle / (2 * np.pi) * 60 + 0.5, 1) - 0.5) < 0.12
    white = np.where(((radius > 0.39) & (radius < 0.42) & minute)[:, None], [0.03, 0.03, 0.03], white)
    for hour in range(12):
        a = 2 * np.pi * hour / 12
        ink = printed(
            writing((str(hour or 12),), 64, 64),
            (x - 0.32 * np.sin(a)) / 0.12 + 0.5,
            (z - 0.32 * np.cos(a)) / 0.12 + 0.5,
        )
        white = mix(white, [0.03, 0.03, 0.03], ink)
    name = printed(writing(("NORTH & VALE",), 256, 32), (x + 0.12) / 0.24, (z - 0.11) / 0.04)
    white = mix(white, [0.30, 0.05, 0.04], name)
    return coat(part, (
        ("case", oak, 0.2, 0), ("plinth", 0.6 * oak, 0.2, 0), ("top", 0.8 * oak, 0.2, 0), ("gable", oak, 0.2, 0),
        ("dial", white, 0.35, 0), ("brass", [0.80, 0.60, 0.26], 0.22, 1), ("hand", [0.04, 0.05, 0.10], 0.3, 0),
    ))  # fmt: skip


def fruit() -> list[Solid]:
    """A blue bowl of fruit on a striped cloth."""
    bowl = turned(
        "bowl", [(0, 0.0), (0.22, 0.0)], smooth((0.22, 0), (0.25, 0.02), (0.24, 0.06)),
        smooth((0.24, 0.06), (0.48, 0.16), (0.62, 0.36), (0.64, 0.40)), [(0.64, 0.40), (0.615, 0.41)],
        smooth((0.615, 0.41), (0.59, 0.36), (0.45, 0.20), (0.20, 0.12)), [(0.20, 0.12), (0, 0.11)], sides=110,
    )  # fmt: skip
    found = [table(1.15), bowl]
    for name, at, size in (
        ("apple", (0.22, 0.10, 0.36), (0.20, 0.20, 0.19)), ("orange", (-0.16, 0.22, 0.36), (0.21, 0.21, 0.21)),
        ("plum", (0.05, -0.26, 0.36), (0.15, 0.15, 0.16)), ("apple", (-0.25, -0.16, 0.38), (0.20, 0.20, 0.18)),
        ("lemon", (0.02, 0.02, 0.60), (0.22, 0.16, 0.16)), ("plum", (0.32, -0.22, 0.42), (0.14, 0.14, 0.15)),
    ):  # fmt: skip
        found.append(ball(name, at, size, sides=56))
    found.append(
        tube("stalk", curve([(0.22, 0.10, 0.53), (0.23, 0.11, 0.60), (0.26, 0.13, 0.65)], 12), 0.014, sides=10)
    )
    banana = curve([(-0.46, 0.10, 0.50), (-0.36, 0.30, 0.60), (-0.12, 0.42, 0.62), (0.16, 0.44, 0.52)], 40)
    thick = 0.075 * np.sqrt(np.clip(1 - np.linspace(-0.97, 0.97, 40) ** 4, 0.06, 1))
    found.append(tube("banana", banana, thick, sides=20))
    return found


def paint_fruit(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    cloth = mix([0.70, 0.66, 0.58], [0.45, 0.12, 0.12], step(np.sin(20 * p[:, 0] + 6 * p[:, 1]), 0.3, 0.15))
    cloth = cloth * (0.85 + 0.15 * (0.5 + 0.5 * np.sin(180 * p[:, 0]) * np.sin(180 * p[:, 1])))[:, None]
    bands = step(np.sin(60 * np.hypot(p[:, 0], p[:, 1])), 0.75, 0.1)
    glaze = mix([0.05, 0.14, 0.36], [0.60, 0.62, 0.60], bands)
    apple = mix([0.55, 0.05, 0.04], [0.66, 0.50, 0.12], step(noise(p * [1, 1, 0.4], 6, 4, 3), 0.1, 0.4))
    orange = mix([0.80, 0.33, 0.03], [0.70, 0.25, 0.02], step(noise(p, 45, 6, 1), 0.2, 0.3))
    yellow = mix([0.80, 0.62, 0.08], [0.30, 0.18, 0.05], step(noise(p, 14, 9, 3), 0.32, 0.15))
    return coat(part, (
        ("table", cloth, 0.8, 0), ("bowl", glaze, 0.15, 0), ("apple", apple, 0.25, 0), ("orange", orange, 0.45, 0),
        ("plum", mix([0.12, 0.03, 0.10], [0.24, 0.14, 0.26], 0.5 + 0.5 * noise(p, 7, 2, 3)), 0.5, 0),
        ("lemon", [0.80, 0.66, 0.06], 0.4, 0), ("stalk", [0.16, 0.09, 0.04], 0.8, 0), ("banana", yellow, 0.5, 0),
    ))  # fmt: skip


SCENES = {
    "fern": Recipe(fern, paint_fern, ("courtyard", 75), 520, heights=(-0.2, 0.92)),
    "mic": Recipe(mic, paint_mic, ("studio", 33), 530, heights=(-0.35, 0.92)),
    "clock": Recipe(clock, paint_clock, ("interior", 140), 540, heights=(-0.3, 0.9)),
    "fruit": Recipe(fruit, paint_fruit, ("interior", 25), 550, heights=(0.25, 0.9), ground=("table",)),
}
