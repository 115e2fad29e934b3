"""Metal beside dielectric in one texture: a chipped flask, a painted padlock."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import mix, noise, printed, step, writing
from benchmarks.scenes.shapes import Solid, box, rod, smooth, tube, turn, turned


def flask() -> list[Solid]:
    """A steel flask, enamelled and chipped, with a cup for a lid and a handle."""
    body = turned(
        "body", [(0, 0), (0.36, 0)], smooth((0.36, 0), (0.40, 0.02), (0.41, 0.06), (0.41, 0.95), count=40),
        smooth((0.41, 0.95), (0.40, 1.02), (0.30, 1.14), (0.27, 1.17)), [(0.27, 1.17), (0.27, 1.21)],
        [(0.27, 1.21), (0.31, 1.21)], smooth((0.31, 1.21), (0.315, 1.30), (0.29, 1.52), (0.27, 1.56), (0.22, 1.58)),
        [(0.22, 1.58), (0, 1.585)],
    )  # fmt: skip
    handle = curve([(0.40, 0, 0.9), (0.60, 0, 0.86), (0.66, 0, 0.62), (0.61, 0, 0.36), (0.40, 0, 0.28)], 36)
    found = [body, tube("handle", handle, 0.05)]
    for z in (0.9, 0.28):
        ring = 0.415 * np.stack([np.cos(np.arange(64) * np.pi / 32), np.sin(np.arange(64) * np.pi / 32)], -1)
        found.append(tube("band", np.column_stack([ring, np.full(64, z)]), 0.024, closed=True))
    return found


def paint_flask(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    angle, z = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    steel = mix((0.56, 0.55, 0.53), (0.68, 0.67, 0.65), 0.5 + 0.5 * noise(p * [4, 4, 40], 1.0, 3, 2))
    wave = z - 0.55 - 0.10 * np.sin(3 * angle) - 0.03 * np.sin(7 * angle)
    enamel = mix((0.05, 0.13, 0.36), (0.70, 0.66, 0.55), step(wave, 0, 0.01))
    enamel = mix(enamel, (0.70, 0.16, 0.05), 1 - step(np.abs(wave - 0.12), 0.03, 0.008))
    worn = noise(p, 6, 9, 4) + 0.35 * step(np.abs(z - 0.52), 0.40, 0.1)
    chip = step(worn, 0.38, 0.02)
    metal = np.where(part == "body", np.where(z > 1.165, step(np.abs(z - 1.4), 0.1, 0.004), chip), 0.0)
    cap = np.where((z > 1.165)[:, None], (0.04, 0.24, 0.15), enamel)
    colour = np.where((part == "body")[:, None], mix(cap, steel, metal), (0.035, 0.03, 0.028))
    colour = np.where((part == "band")[:, None], (0.86, 0.62, 0.28), colour)
    metal = np.where(part == "band", 1.0, metal)
    rough = np.where(part == "handle", 0.55, mix(0.22, 0.34 + 0.08 * noise(p, 9, 5, 2), metal))
    return colour, np.where(part == "band", 0.28, rough), metal


def padlock() -> list[Solid]:
    """A brass lock with a steel shackle, a plate of paint with writing, rubber below, four rivets."""
    body = box("body", (0.5, 0.24, 0.40), 0.07, steps=6).moved((0, 0, 0.4))
    angle = np.linspace(0, np.pi, 33)
    arch = np.stack([0.31 * np.cos(angle), np.zeros(33), 1.05 + 0.31 * np.sin(angle)], -1)
    shackle = np.concatenate(
        [[(0.31, 0, 0.6), (0.31, 0, 0.8), (0.31, 0, 1.0)], arch, [(-0.31, 0, 1.0), (-0.31, 0, 0.86)]]
    )
    found = [body, tube("shackle", shackle, 0.07, sides=24)]
    found.append(box("bumper", (0.53, 0.27, 0.13), 0.06, steps=5).moved((0, 0, 0.11)))
    for x in (-1, 1):
        found.append(tube("collar", ring((0.31 * x, 0, 0.80), 0.095), 0.022, closed=True))
        for side in (-1, 1):
            found.append(rod("rivet", (0.41 * x, 0.22 * side, 0.68), (0.41 * x, 0.265 * side, 0.68), 0.03))
    keyhole = turned(
        "key", [(0, 0), (0.13, 0)], [(0.13, 0), (0.13, 0.03)], [(0.13, 0.03), (0.1, 0.045), (0, 0.045)], sides=48
    )
    return [*found, keyhole.moved((0, 0.225, 0.42), turn(0, -90))]


def ring(middle: tuple[float, float, float], radius: float, count: int = 40) -> np.ndarray:
    """A level circle [count, 3]."""
    angle = np.arange(count) * 2 * np.pi / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)], -1) + middle


def paint_padlock(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    brushed = noise(p * [3, 3, 60], 1.0, 11, 2)
    brass = mix((0.80, 0.56, 0.24), (0.90, 0.68, 0.34), 0.5 + 0.5 * brushed)
    words = writing(("SERIES 7", "No 48 213", "KEEP DRY", "hardened"), 512, 400, 6)
    plate = (np.abs(x) < 0.36) & (np.abs(z - 0.50) < 0.24) & (np.abs(y) > 0.2)
    ink = printed(words, 0.5 - np.sign(y) * x / 0.72, (z - 0.26) / 0.48)
    front = mix(mix((0.05, 0.10, 0.28), (0.10, 0.17, 0.38), 0.5 + 0.5 * noise(p, 5, 2, 2)), (0.80, 0.78, 0.70), ink)
    scratch = step(noise(p * [1, 1, 5], 7, 31, 4), 0.42, 0.03)
    covered = np.where(plate & (part == "body"), 1 - scratch, 0.0)
    stripes = step(np.sin(60 * (x + z + y)), 0.0, 0.3)
    side = np.where((np.abs(x) > 0.47) & (part == "body"), 1 - step(np.abs(z - 0.5), 0.18, 0.01), 0.0)
    colour = mix(mix(brass, front, covered), mix((0.75, 0.55, 0.04), (0.03, 0.03, 0.03), stripes), side * (1 - scratch))
    metal = (1 - covered) * (1 - side * (1 - scratch))
    rough = mix(0.28, 0.32 + 0.07 * brushed, metal)
    steel = mix((0.60, 0.60, 0.62), (0.50, 0.49, 0.48), step(noise(p, 5, 7, 3), 0.1, 0.4))
    for name, value, gloss, is_metal in (
        ("shackle", steel, 0.20 + 0.1 * step(noise(p, 5, 7, 3), 0.1, 0.4), 1),
        ("collar", np.full_like(p, 0.05), 0.5, 0),
        ("bumper", mix((0.30, 0.03, 0.02), (0.40, 0.06, 0.04), 0.5 + 0.5 * noise(p, 12, 1, 2)), 0.6, 0),
        ("rivet", np.broadcast_to((0.93, 0.85, 0.80), p.shape), 0.25, 1), ("key", steel, 0.3, 1),
    ):  # fmt: skip
        mine = part == name
        colour = np.where(mine[:, None], value, colour)
        rough, metal = np.where(mine, gloss, rough), np.where(mine, is_metal, metal)
    slot = (part == "key") & (np.abs(z - 0.42) < 0.09) & (np.abs(x) < 0.018 + 0.02 * (z > 0.46)) & (y > 0.25)
    return np.where(slot[:, None], 0.02, colour), rough, np.where(slot, 0.0, metal)


SCENES = {
    "flask": Recipe(flask, paint_flask, ("courtyard", 340), 110, heights=(-0.4, 0.9)),
    "padlock": Recipe(padlock, paint_padlock, ("studio", 34), 210, heights=(-0.4, 0.9)),
}
