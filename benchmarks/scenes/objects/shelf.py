"""Three scenes for choosing: a white teapot, a toaster of chrome, a printed tin can."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import coat, mix, noise, printed, sentences, step, writing
from benchmarks.scenes.shapes import Solid, ball, block, box, carve, level_set, rod, smooth, tube, turn, turned


def teapot() -> list[Solid]:
    """A round pot of white glazed china with a spout, a handle and a lid: nearly nothing on it tells one place from
    another."""
    pot = turned(
        "china", [(0, 0.02), (0.30, 0.02)], smooth((0.30, 0.02), (0.33, 0.0), (0.36, 0.03)),
        smooth((0.36, 0.03), (0.58, 0.22), (0.64, 0.48), (0.52, 0.78), (0.34, 0.90), count=48),
        [(0.34, 0.90), (0.33, 0.93)], smooth((0.33, 0.93), (0.24, 1.0), (0.10, 1.05), (0.05, 1.06)),
        [(0.05, 1.06), (0, 1.06)], sides=128,
    )  # fmt: skip
    spout = curve([(0.50, 0, 0.38), (0.70, 0, 0.46), (0.82, 0, 0.66), (0.90, 0, 0.86), (0.98, 0, 0.93)], 40)
    handle = curve(
        [(-0.50, 0, 0.76), (-0.70, 0, 0.84), (-0.88, 0, 0.70), (-0.86, 0, 0.46), (-0.70, 0, 0.30), (-0.55, 0, 0.28)], 48
    )
    found = [pot, tube("china", spout, np.linspace(0.15, 0.055, 40), sides=28)]
    found += [tube("china", handle, 0.05, sides=20), ball("gold", (0, 0, 1.12), (0.085, 0.085, 0.075), sides=40)]
    found.append(tube("gold", ring((0, 0, 0.915), 0.338, 96), 0.014, closed=True))
    return found


def paint_teapot(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    band = step(np.abs(p[:, 2] - 0.20), 0.012, 0.004) * step(np.abs(p[:, 2] - 0.245), 0.006, 0.003)
    white = mix([0.10, 0.16, 0.42], [0.82, 0.81, 0.78], np.where(np.hypot(p[:, 0], p[:, 1]) < 0.66, band, 1))
    return coat(part, (("china", white, 0.12, 0), ("gold", [0.90, 0.68, 0.30], 0.25, 1)))


def toaster() -> list[Solid]:
    """A bread toaster: a box of polished steel with two slots and black ends, a lever, a knob, a cord."""

    def case(p: np.ndarray) -> np.ndarray:
        found = block(p, (0, 0, 0.44), (0.62, 0.34, 0.42), 0.16)
        for y in (-0.12, 0.12):
            found = carve(found, block(p, (0, y, 0.9), (0.48, 0.055, 0.5), 0.03), 0.015)
        return found

    found = [level_set("steel", case, 1.0, cells=200, faces=24000)]
    for x in (-0.66, 0.66):
        found.append(box("end", (0.10, 0.35, 0.40), 0.08, steps=6).moved((x, 0, 0.43)))
    found.append(box("lever", (0.07, 0.10, 0.03), 0.02).moved((0.80, 0, 0.62)))
    dial = turned(
        "knob", [(0, 0), (0.11, 0)], [(0.11, 0), (0.10, 0.07)], smooth((0.10, 0.07), (0.09, 0.085), (0, 0.09)), sides=48
    )
    found.append(dial.moved((0.755, 0.0, 0.28), turn(1, 90)))
    for x in (-0.5, 0.5):
        for y in (-0.22, 0.22):
            found.append(rod("foot", (x, y, -0.05), (x, y, 0.08), 0.06, sides=24))
    cord = [(-0.72, 0.15, 0.12), (-0.85, 0.2, 0.05), (-0.9, 0.45, -0.01), (-0.5, 0.62, -0.02), (0.1, 0.55, -0.02)]
    found.append(tube("foot", curve([*cord, (0.4, 0.68, -0.02)], 60), 0.028, sides=12))
    return found


def paint_toaster(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    ink = printed(writing(("EMBERLY",), 256, 48), (p[:, 0] + 0.30) / 0.60, (p[:, 2] - 0.16) / 0.11)
    ink = np.where((part == "steel") & (n[:, 1] < -0.7), ink, 0)
    steel = mix([0.72, 0.71, 0.69], [0.60, 0.06, 0.05], ink)
    marks = step(np.sin(9 * np.arctan2(p[:, 1], p[:, 2] - 0.28)), 0.8, 0.1)
    base, rough, metal = coat(part, (
        ("steel", steel, 0.12, 1), ("end", [0.03, 0.03, 0.035], 0.3, 0), ("lever", [0.60, 0.10, 0.05], 0.35, 0),
        ("knob", mix([0.55, 0.55, 0.52], [0.05, 0.05, 0.05], marks), 0.4, 0), ("foot", [0.05, 0.05, 0.05], 0.6, 0),
    ))  # fmt: skip
    return base, np.where(ink > 0.5, 0.3, rough), metal * (ink < 0.5)


def can() -> list[Solid]:
    """A drinks can: ink with small writing on brushed aluminium, bare at the neck, the lid and the bottom."""
    body = turned(
        "can", [(0, 0.06), (0.22, 0.03)], smooth((0.22, 0.03), (0.27, 0.0), (0.30, 0.02)),
        smooth((0.30, 0.02), (0.36, 0.08), (0.38, 0.14)), [(0.38, 0.14), (0.38, 0.6), (0.38, 1.22)],
        smooth((0.38, 1.22), (0.37, 1.28), (0.32, 1.38)), [(0.32, 1.38), (0.32, 1.42)], [(0.32, 1.42), (0.295, 1.42)],
        [(0.295, 1.42), (0.28, 1.37)], [(0.28, 1.37), (0, 1.37)], sides=128,
    )  # fmt: skip
    tab = ring((0.06, 0, 1.395), 0.075, 40)
    return [body, tube("tab", tab, 0.02, closed=True), rod("tab", (-0.05, 0, 1.37), (-0.05, 0, 1.41), 0.035)]


def paint_can(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    angle, z = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    metal = mix([0.72, 0.72, 0.73], [0.82, 0.82, 0.82], 0.5 + 0.5 * noise(p * [3, 3, 50], 1.0, 6, 2))
    sweep = z - 0.72 - 0.22 * np.sin(angle) - 0.06 * np.sin(3 * angle)
    ink = mix([0.04, 0.20, 0.12], [0.72, 0.68, 0.10], step(sweep, 0, 0.012))
    ink = mix([0.80, 0.80, 0.78], ink, step(np.abs(sweep), 0.035, 0.008))
    for middle, lines, colour, size in (
        (0.6, ("ZESTY", "LIME"), [0.82, 0.82, 0.80], (0.42, 0.36, 0.78)),
        (-2.3, sentences(3, 7, 4), [0.02, 0.03, 0.02], (0.40, 0.30, 0.86)),
        (3.0, ("330 ML", *sentences(8, 4, 3)), [0.82, 0.82, 0.80], (0.30, 0.28, 0.44)),
    ):
        turned_ = np.mod(angle - middle + np.pi, 2 * np.pi) - np.pi
        picture = writing(tuple(lines), 512, 384)
        pen = printed(picture, 0.38 * turned_ / size[0] + 0.5, (z - size[2]) / size[1] + 0.5)
        ink = mix(ink, colour, pen)
    drops = step(noise(p, 14, 4, 2), 0.42, 0.03)
    bare = ((z < 0.13) | (z > 1.26) | (part == "tab")).astype(float)
    share = np.maximum(bare, drops * (sweep > 0.06))
    return mix(ink, metal, share), mix(0.24, 0.2 + 0.06 * noise(p, 8, 2, 2), share), share


SCENES = {
    "teapot": Recipe(teapot, paint_teapot, ("interior", 61), 560, heights=(-0.3, 0.9)),
    "toaster": Recipe(toaster, paint_toaster, ("studio", 47), 570, heights=(-0.1, 0.92)),
    "can": Recipe(can, paint_can, ("courtyard", 19), 580, heights=(-0.4, 0.9)),
}
