"""Three small scenes for choosing (256 pixels) of kinds that peers publish: a meal, a drum kit, a scaled beast."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.paint import coat, mix, noise, step
from benchmarks.scenes.shapes import (
    Solid,
    ball,
    blend,
    box,
    capsule,
    carve,
    ellipsoid,
    leaf,
    level_set,
    rod,
    smooth,
    tube,
    turn,
    turned,
)


def meal() -> list[Solid]:
    """A wide white plate with two filled rolls and some leaves, under a sun that throws hard shadows."""
    plate = turned(
        "plate",
        [(0.0, -0.16), (0.55, -0.16)],
        smooth((0.55, -0.16), (0.80, -0.12), (1.02, 0.0)),
        [(1.02, 0.0), (1.02, 0.03)],
        smooth((1.02, 0.03), (0.80, -0.07), (0.62, -0.10), (0.54, -0.105)),
        [(0.54, -0.105), (0.0, -0.105)],
        sides=128,
    )

    def roll(p: np.ndarray) -> np.ndarray:
        bread = capsule(p * [1, 1, 1.15], (-0.36, 0, 0), (0.36, 0, 0), 0.19)
        return carve(bread, capsule(p, (-0.8, 0, 0.17), (0.8, 0, 0.17), 0.11), 0.04)

    found = [plate]
    for k, (y, angle) in enumerate(((-0.27, 6), (0.27, -5))):
        where, round_ = (0, y, 0.03), turn(2, angle)
        found.append(level_set("roll", roll, 0.75, cells=110, faces=7000).moved(where, round_))
        bend = np.linspace(-1, 1, 33)
        body = np.column_stack([0.58 * bend, 0.02 * np.sin(3 * bend + k), 0.20 + 0.05 * bend**2])
        thick = 0.088 * np.sqrt(np.clip(1.02 - bend**8, 0.02, 1))
        found.append(tube("sausage", body, thick, sides=22).moved(where, round_))
        zigzag = np.linspace(-1, 1, 90)
        line = np.column_stack([0.46 * zigzag, 0.05 * np.sin(zigzag * 24), 0.288 + 0.04 * zigzag**2])
        found.append(tube("mustard", line, 0.018, sides=10).moved(where, round_))
    rng = np.random.default_rng(4)
    for k in range(7):
        at = (0.50 * np.cos(0.5 + 0.25 * k) * (1 if k % 2 else -1), (0.55 + 0.05 * (k % 3)) * (-1) ** (k // 4), -0.09)
        blade = leaf("leaf", 0.30, 0.11, 0.008, rng.uniform(-0.3, 0.3))
        found.append(blade.moved(at, turn(2, rng.uniform(0, 360)) @ turn(1, -12)))
    found += [ball("pea", (-0.72, -0.22 + 0.13 * k, -0.015), (0.05, 0.05, 0.05), sides=24) for k in range(4)]
    return found


def paint_meal(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    band = (np.abs(np.hypot(p[:, 0], p[:, 1]) - 0.93) < 0.03) & (n[:, 2] > 0)
    china = np.where(band[:, None], (0.06, 0.10, 0.30), (0.80, 0.79, 0.76))
    crust = mix([0.62, 0.36, 0.13], [0.40, 0.17, 0.05], 0.5 + 0.5 * noise(p, 4, 3, 3))
    crumb = mix([0.80, 0.68, 0.46], crust, step(n[:, 2], 0.75, 0.3) * 0.3 + 0.7)
    meat = mix([0.42, 0.10, 0.05], [0.26, 0.05, 0.03], step(np.sin(p[:, 0] * 26), 0.6, 0.3))
    green = mix([0.10, 0.28, 0.05], [0.28, 0.46, 0.10], 0.5 + 0.5 * noise(p, 12, 9, 2))
    return coat(part, (
        ("plate", china, 0.12, 0), ("roll", crumb, 0.75, 0), ("sausage", meat, 0.28, 0),
        ("mustard", [0.76, 0.50, 0.03], 0.2, 0), ("leaf", green, 0.4, 0), ("pea", [0.22, 0.42, 0.07], 0.35, 0),
    ))  # fmt: skip


def drums() -> list[Solid]:
    """Lacquered drums with white heads, thin cymbals of brass on stands of chromed rods."""

    def drum(radius: float, half: float) -> list[Solid]:
        shell = turned("shell", [(0, -half), (radius, -half)], [(radius, -half), (radius, half)],
                       [(radius, half), (0, half)], sides=72)  # fmt: skip
        hoops = [tube("chrome", ring((0, 0, side * half), radius, 72), 0.02, closed=True) for side in (-1, 1)]
        around = np.arange(6) * np.pi / 3
        lugs = [
            rod("chrome", (radius * 1.03 * np.cos(a), radius * 1.03 * np.sin(a), -0.8 * half),
                (radius * 1.03 * np.cos(a), radius * 1.03 * np.sin(a), 0.8 * half), 0.014, sides=10) for a in around
        ]  # fmt: skip
        return [shell, *hoops, *lugs]

    found: list[Solid] = []

    def put(parts: list[Solid], shift: tuple, round_: np.ndarray | None = None) -> None:
        found.extend(part.moved(shift, round_) for part in parts)

    put(drum(0.40, 0.26), (0, 0.05, -0.36), turn(0, 90))
    put(drum(0.20, 0.13), (-0.24, 0.02, 0.24), turn(0, 22))
    put(drum(0.20, 0.14), (0.24, 0.02, 0.24), turn(0, 22))
    put(drum(0.26, 0.22), (0.68, -0.36, -0.45))
    put(drum(0.24, 0.09), (-0.62, -0.36, -0.22))
    for x in (-0.24, 0.24):
        found.append(rod("chrome", (0.5 * x, 0.05, -0.02), (x, 0.03, 0.16), 0.022))
    for x, y, low in ((-0.62, -0.36, -0.30), (0.68, -0.36, -0.6)):
        for k in range(3):
            a = 0.4 + k * 2 * np.pi / 3
            found.append(
                rod("chrome", (x, y, low), (x + 0.25 * np.cos(a), y + 0.25 * np.sin(a), -0.76), 0.016, sides=10)
            )
    for x, y, z, radius, tilt in (
        (-0.78, 0.30, 0.50, 0.34, 14),
        (0.78, 0.32, 0.58, 0.36, -12),
        (-0.98, -0.25, 0.10, 0.24, 4),
    ):
        bell = turned("brass", smooth((0.0, -0.007), (0.05, -0.012), (0.09, -0.035), (radius, -0.075)),
                      [(radius, -0.075), (radius, -0.063)],
                      smooth((radius, -0.063), (0.09, -0.023), (0.05, 0.0), (0.0, 0.007)), sides=96)  # fmt: skip
        found.append(bell.moved((x, y, z + 0.03), turn(1, tilt)))
        found.append(rod("chrome", (x, y, -0.62), (x, y, z + 0.07), 0.016, sides=12))
        for k in range(3):
            a = 1.0 + k * 2 * np.pi / 3
            found.append(
                rod("chrome", (x, y, -0.5), (x + 0.24 * np.cos(a), y + 0.24 * np.sin(a), -0.76), 0.016, sides=10)
            )
    found.append(box("stool", (0.2, 0.2, 0.04), 0.035).moved((0, -0.72, -0.36)))
    for k in range(4):
        a = np.pi / 4 + k * np.pi / 2
        found.append(
            rod("chrome", (0, -0.72, -0.38), (0.22 * np.cos(a), -0.72 + 0.22 * np.sin(a), -0.76), 0.02, sides=10)
        )
    return found


def paint_drums(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    lacquer = mix([0.42, 0.03, 0.03], [0.60, 0.10, 0.05], step(noise(p, 14, 3, 2), 0.1, 0.3))
    grooves = mix([0.80, 0.58, 0.24], [0.62, 0.42, 0.16], 0.5 + 0.5 * noise(p, 10, 6, 3))
    return coat(part, (
        ("shell", lacquer, 0.12, 0), ("chrome", [0.62, 0.62, 0.63], 0.2, 1), ("brass", grooves, 0.3, 1),
        ("stool", [0.03, 0.03, 0.035], 0.45, 0),
    ))  # fmt: skip


def paint_heads(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    """`paint_drums`, with heads of white skin: the flat ends of shells, which are known by their normals."""
    base, rough, metal = paint_drums(p, n, part)
    tilted = np.abs(n @ turn(0, 22)[:, 2]) > 0.98
    flat = (np.abs(n[:, 2]) > 0.98) | (np.abs(n[:, 1]) > 0.98) | tilted
    head = (part == "shell") & flat
    base[head], rough[head] = (0.74, 0.72, 0.67), 0.6
    return base, rough, metal


def beast() -> list[Solid]:
    """A standing beast of one colour whose hide is scales, between two lamps."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        body = blend(
            ellipsoid(p, (0, 0.02, -0.1), (0.36, 0.33, 0.44)), ellipsoid(p, (0, 0.0, 0.22), (0.28, 0.25, 0.26)), 0.12
        )
        head = blend(
            ellipsoid(p, (0, -0.08, 0.62), (0.19, 0.20, 0.18)),
            capsule(p, (0, -0.2, 0.58), (0, -0.42, 0.50), 0.085),
            0.08,
        )
        body = blend(body, blend(head, capsule(p, (0, 0, 0.3), (0, -0.04, 0.55), 0.13), 0.08), 0.06)
        for side in (-1, 1):
            ear = ellipsoid(p, (0.17 * side, -0.02, 0.84), (0.06, 0.04, 0.16))
            arm = blend(
                capsule(p, (0.28 * side, 0, 0.26), (0.58 * side, -0.16, 0.34), 0.085),
                capsule(p, (0.58 * side, -0.16, 0.34), (0.66 * side, -0.30, 0.62), 0.065),
                0.05,
            )
            for k in (-1, 0, 1):
                arm = blend(
                    arm, capsule(p, (0.66 * side, -0.30, 0.62), ((0.66 + 0.07 * k) * side, -0.36, 0.78), 0.028), 0.03
                )
            leg = blend(
                capsule(p, (0.2 * side, 0, -0.35), (0.33 * side, -0.14, -0.62), 0.14),
                capsule(p, (0.33 * side, -0.14, -0.62), (0.30 * side, -0.02, -0.90), 0.10),
                0.06,
            )
            leg = blend(leg, ellipsoid(p, (0.30 * side, -0.12, -0.93), (0.12, 0.20, 0.07)), 0.05)
            body = blend(body, blend(blend(arm, leg, 0.05), ear, 0.04), 0.06)
        tail = capsule(p, (0, 0.28, -0.36), (0.05, 0.66, -0.78), 0.11)
        body = blend(body, blend(tail, capsule(p, (0.05, 0.66, -0.78), (0.22, 0.86, -0.88), 0.06), 0.05), 0.08)
        scales = np.sin(34 * x + 3 * np.sin(9 * z)) * np.sin(34 * z + 17 * y)
        back = 1 / (1 + np.exp(-(y - 0.02) / 0.04))
        ridge = 0.018 * np.clip(np.sin(28 * z), 0, 1) * back
        return body - 0.010 * scales - ridge

    return [level_set("beast", distance, 1.1, cells=180, faces=40000)]


def paint_beast(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    return np.broadcast_to((0.46, 0.30, 0.16), p.shape), np.full(len(p), 0.35), np.zeros(len(p))


SCENES = {
    "meal": Recipe(meal, paint_meal, ("sun", 3), 460, heights=(0.05, 0.95)),
    "drums": Recipe(drums, paint_heads, ("studio", 71), 470, heights=(-0.1, 0.9)),
    "beast": Recipe(beast, paint_beast, ("lamps", 12), 480, heights=(-0.3, 0.9)),
}
