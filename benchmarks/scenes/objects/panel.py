"""Nine plain scenes for choosing, small and quick: what shines, what is metal, what is rough, what is hollow.

A threshold that rests on one shiny scene is that scene's own. These are made at 256 pixels (`--size 256`), and differ
from the scenes kept for scoring in shape, paint and light.
"""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import mix, noise, step
from benchmarks.scenes.shapes import (
    Solid,
    ball,
    blend,
    block,
    box,
    capsule,
    carve,
    ellipsoid,
    level_set,
    rod,
    smooth,
    tube,
    turn,
    turned,
)


def vase() -> list[Solid]:
    """A bellied vase of dark glaze with two ears, its foot and one band bare clay."""
    belly = [(0.26, 0), (0.29, 0.06), (0.50, 0.55), (0.44, 0.95), (0.19, 1.22), (0.18, 1.32), (0.27, 1.46)]
    body = turned(
        "body", [(0, 0), (0.26, 0)], smooth(*belly, count=80), smooth((0.27, 1.46), (0.255, 1.475), (0.23, 1.46)),
        smooth((0.23, 1.46), (0.145, 1.32), (0.15, 1.2)), [(0.15, 1.2), (0, 1.19)],
    )  # fmt: skip
    found = [body]
    for side in (-1, 1):
        ear = curve(
            [(0.17 * side, 0, 1.26), (0.34 * side, 0, 1.30), (0.42 * side, 0, 1.12), (0.40 * side, 0, 0.98)], 32
        )
        found.append(tube("ear", ear, 0.035, sides=18))
    return found


def paint_vase(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    z, angle = p[:, 2], np.arctan2(p[:, 1], p[:, 0])
    run = noise(np.column_stack([np.cos(angle) * 2, np.sin(angle) * 2, z * 0.6]), 3.0, 17, 3)
    glaze = mix((0.012, 0.020, 0.045), (0.035, 0.060, 0.105), 0.5 + 0.5 * run)
    leaf = step(np.sin(5 * angle) * np.sin(np.pi * np.clip((z - 0.35) / 0.4, 0, 1)), 0.55, 0.06)
    glaze = mix(glaze, (0.30, 0.09, 0.03), leaf)
    clay = mix((0.36, 0.24, 0.16), (0.46, 0.32, 0.22), 0.5 + 0.5 * noise(p, 9, 5, 3))
    bare = np.maximum(1 - step(z, 0.10 + 0.02 * np.sin(4 * angle), 0.01), 1 - step(np.abs(z - 0.98), 0.045, 0.008))
    bare = np.where(part == "ear", 0.0, bare)
    return mix(glaze, clay, bare), mix(0.11 + 0.04 * (run > 0.2), 0.75, bare), np.zeros(len(p))


def blocks() -> list[Solid]:
    """A tower of a child's blocks: a ball, an arch's legs, a cone, bars, each of one colour."""
    cone = turned("cone", [(0, 0), (0.24, 0)], [(0.24, 0), (0.02, 0.46)], [(0.02, 0.46), (0, 0.47)])
    return [
        box("plate", (0.60, 0.45, 0.06), 0.03).moved((0, 0, 0.06)),
        box("left", (0.11, 0.24, 0.26), 0.03).moved((-0.38, 0, 0.38)),
        box("right", (0.11, 0.24, 0.26), 0.03).moved((0.38, 0, 0.38)),
        box("beam", (0.58, 0.24, 0.09), 0.03).moved((0, 0, 0.73)),
        ball("ball", (0.0, -0.02, 0.34), (0.23, 0.23, 0.23)),
        cone.moved((-0.30, 0, 0.80)),
        rod("peg", (0.28, 0, 0.80), (0.28, 0, 1.22), 0.13, sides=48),
    ]


def paint_blocks(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    colour, rough = np.empty_like(p), np.empty(len(p))
    for name, value, gloss in (
        ("plate", (0.55, 0.56, 0.52), 0.5), ("left", (0.62, 0.05, 0.04), 0.18), ("right", (0.04, 0.16, 0.50), 0.22),
        ("beam", (0.72, 0.52, 0.06), 0.28), ("ball", (0.78, 0.76, 0.72), 0.14), ("cone", (0.07, 0.36, 0.10), 0.35),
        ("peg", (0.42, 0.12, 0.40), 0.25),
    ):  # fmt: skip
        mine = part == name
        colour[mine], rough[mine] = value, gloss
    worn = step(noise(p, 9, 41, 4), 0.35, 0.1)
    return colour * (1 - 0.25 * worn[:, None]), np.minimum(rough + 0.2 * worn, 0.8), np.zeros(len(p))


def lantern() -> list[Solid]:
    """A brass lantern: a pierced drum between two rims, a domed lid with a knob, a bail."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        round_, angle = np.hypot(x, y), np.arctan2(y, x)
        drum = np.maximum(np.abs(round_ - 0.46) - 0.035, np.abs(z + 0.05) - 0.50)
        near = np.mod(angle * 10 / (2 * np.pi), 1) - 0.5
        for high in (-0.28, 0.16):
            drum = carve(drum, np.hypot(near * 2 * np.pi / 10 * 0.46, (z - high) * 0.75) - 0.10, 0.015)
        floor = np.maximum(round_ - 0.56, np.abs(z + 0.60) - 0.06)
        rim = np.maximum(round_ - 0.54, np.abs(z - 0.46) - 0.05)
        lid = np.maximum(ellipsoid(p, (0, 0, 0.46), (0.48, 0.48, 0.34)), 0.46 - z)
        return np.minimum(
            blend(np.minimum(drum, floor), blend(rim, lid, 0.03), 0.02), ellipsoid(p, (0, 0, 0.85), (0.09, 0.09, 0.1))
        )

    arc = np.linspace(-1.0, 1.0, 40) * 2.2
    bail = np.stack([0.50 * np.sin(arc), np.zeros(40), 0.62 + 0.5 * np.cos(arc)], -1)
    return [level_set("brass", distance, 1.15, cells=150, faces=26000), tube("bail", bail, 0.022, sides=12)]


def paint_lantern(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    patina = step(noise(p, 4, 29, 4), 0.18, 0.25)
    brass = mix((0.86, 0.62, 0.28), (0.70, 0.46, 0.22), 0.5 + 0.5 * noise(p * [1, 1, 6], 5, 3, 2))
    colour = mix(brass, (0.10, 0.20, 0.17), patina)
    rough = mix(0.24 + 0.06 * noise(p, 8, 6, 2), 0.6, patina)
    grip = (part == "bail")[:, None]
    return (
        np.where(grip, (0.04, 0.04, 0.045), colour),
        np.where(part == "bail", 0.45, rough),
        np.where(part == "bail", 0.0, 1 - patina),
    )


def boulder() -> list[Solid]:
    """A mossy stone with a smaller one leaning on it."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        big = ellipsoid(p, (-0.12, 0.05, -0.02), (0.66, 0.55, 0.60))
        small = ellipsoid(p, (0.56, -0.22, -0.34), (0.34, 0.30, 0.26))
        rock = blend(big, small, 0.08)
        bumps = np.sin(7 * x + 2 * np.sin(5 * y)) * np.sin(6 * y + 1) * np.sin(8 * z + 2 * np.sin(4 * x))
        rock = rock + 0.035 * bumps + 0.012 * np.sin(23 * x + 3) * np.sin(21 * y) * np.sin(25 * z)
        return np.maximum(rock, -(z + 0.52))

    return [level_set("stone", distance, 1.05, cells=150, faces=26000)]


def paint_boulder(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    grain = 0.5 + 0.5 * noise(p, 14, 8, 4)
    stone = mix((0.20, 0.19, 0.18), (0.52, 0.48, 0.43), grain)
    moss = step(n[:, 2] + 0.7 * noise(p, 4, 77, 3), 0.75, 0.3)
    green = mix((0.06, 0.10, 0.02), (0.16, 0.22, 0.05), 0.5 + 0.5 * noise(p, 40, 12, 2))
    return mix(stone, green, moss), np.full(len(p), 0.85), np.zeros(len(p))


def niche() -> list[Solid]:
    """An upright block with a deep arched recess in front, coloured inside, and a figure of three balls in it."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        wall = block(p, (0, 0, 0), (0.62, 0.52, 0.86), 0.05)
        arch = np.where(z < 0.25, np.abs(x), np.hypot(x, z - 0.25)) - 0.42
        hollow = np.maximum(np.maximum(arch, np.abs(y + 0.30) - 0.58), -(z + 0.62))
        return carve(wall, hollow, 0.02)

    return [
        level_set("wall", distance, 1.0, cells=150, faces=22000),
        ball("low", (0.0, -0.10, -0.45), (0.21, 0.21, 0.20)),
        ball("middle", (0.0, -0.10, -0.17), (0.15, 0.15, 0.15)),
        ball("top", (0.0, -0.10, 0.04), (0.10, 0.10, 0.10)),
    ]


def paint_niche(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    inside = (np.abs(x) < 0.43) & (y > -0.50) & (y < 0.30) & (z > -0.64) & (z < 0.69)
    tiles = step(np.sin(26 * z) * np.sin(26 * (x + y)), 0.0, 0.2)
    left = mix((0.66, 0.12, 0.08), (0.74, 0.24, 0.12), tiles)
    right = mix((0.10, 0.24, 0.60), (0.16, 0.38, 0.66), tiles)
    back = mix((0.72, 0.70, 0.66), (0.50, 0.46, 0.20), tiles)
    lining = np.where((y > 0.26)[:, None], back, np.where((x < 0)[:, None], left, right))
    plaster = mix((0.50, 0.44, 0.36), (0.62, 0.57, 0.48), 0.5 + 0.5 * noise(p, 6, 13, 4))
    colour = np.where(inside[:, None], lining, plaster)
    rough = np.where(inside, 0.5, 0.8)
    for name, value, gloss in (
        ("low", (0.75, 0.74, 0.70), 0.6),
        ("middle", (0.70, 0.60, 0.10), 0.3),
        ("top", (0.08, 0.40, 0.34), 0.4),
    ):
        colour = np.where((part == name)[:, None], value, colour)
        rough = np.where(part == name, gloss, rough)
    return colour, rough, np.zeros(len(p))


def wheel() -> list[Solid]:
    """A wheel on a stand: a rubber tyre, a steel rim, eighteen crossed spokes, a painted hub."""

    def at(x: float, y: float, z: float) -> np.ndarray:
        return np.array([x, y, z + 0.75])

    def upright(radius: float) -> np.ndarray:
        return ring((0, 0, 0), radius, 96)[:, [0, 2, 1]] + at(0, 0, 0)

    found = [
        tube("tyre", upright(0.62), 0.055, sides=18, closed=True),
        tube("rim", upright(0.555), 0.032, sides=12, closed=True),
        rod("hub", at(0, -0.16, 0), at(0, 0.16, 0), 0.075, sides=32),
    ]
    for k in range(18):
        side = 0.10 if k % 2 else -0.10
        outer, inner = k * 2 * np.pi / 18, k * 2 * np.pi / 18 + (0.35 if k % 4 < 2 else -0.35)
        start = at(0.06 * np.cos(inner), side, 0.06 * np.sin(inner))
        found.append(rod("spoke", start, at(0.55 * np.cos(outer), 0, 0.55 * np.sin(outer)), 0.011, sides=8))
    for y in (-0.2, 0.2):
        for x in (-0.34, 0.34):
            found.append(rod("stand", (x, 1.4 * y, 0.0), (0, 0.72 * y, 0.75), 0.022))
        found.append(rod("stand", (-0.34, 1.4 * y, 0.02), (0.34, 1.4 * y, 0.02), 0.022))
    return found


def paint_wheel(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    colour, rough, metal = np.empty_like(p), np.empty(len(p)), np.zeros(len(p))
    dust = 0.5 + 0.5 * noise(p, 10, 4, 3)
    for name, value, gloss, is_metal in (
        ("tyre", mix((0.03, 0.03, 0.03), (0.09, 0.085, 0.08), dust), 0.7, 0), ("rim", (0.60, 0.60, 0.61), 0.3, 1),
        ("hub", (0.60, 0.30, 0.03), 0.3, 0), ("spoke", (0.55, 0.55, 0.56), 0.35, 1),
        ("stand", mix((0.10, 0.30, 0.16), (0.16, 0.40, 0.22), dust), 0.45, 0),
    ):  # fmt: skip
        mine = part == name
        colour[mine] = value[mine] if np.ndim(value) == 2 else value
        rough[mine], metal[mine] = gloss, is_metal
    return colour, rough, metal


def radio() -> list[Solid]:
    """A table radio of black plastic: a rounded case with grooves over the speaker, a dial behind a step, two knobs."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        case = block(p, (0, 0, 0), (0.80, 0.32, 0.46), 0.14)
        case = blend(case, ellipsoid(p, (0, 0.02, 0.34), (0.62, 0.26, 0.30)), 0.10)
        for k in range(6):
            high = 0.26 - 0.105 * k
            wide = 0.30 - 0.5 * (high - 0.0) ** 2
            groove = capsule(p, (-0.36 - wide, -0.335, high), (-0.36 + wide, -0.335, high), 0.03)
            case = carve(case, groove, 0.02)
        case = carve(case, np.maximum(np.hypot(x - 0.36, z - 0.12) - 0.24, y + 0.28), 0.02)
        back = np.maximum(np.abs(x) - 0.5, np.abs(z) - 0.26)
        return carve(case, np.maximum(back, 0.27 - y), 0.03)

    found = [level_set("case", distance, 1.0, cells=150, faces=26000)]
    for x in (0.20, 0.52):
        profile = smooth((0.085, 0), (0.08, 0.07), (0.072, 0.10), (0.05, 0.108))
        knob = turned("knob", [(0, 0), (0.085, 0)], profile, [(0.05, 0.108), (0, 0.108)], sides=40)
        found.append(knob.moved((x, -0.315, -0.27), turn(0, 90)))
    for x in (-0.55, 0.55):
        found.append(box("foot", (0.10, 0.22, 0.05), 0.02).moved((x, 0, -0.47)))
    return found


def paint_radio(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    dust = 0.5 + 0.5 * noise(p, 7, 23, 3)
    colour = mix((0.014, 0.013, 0.013), (0.034, 0.030, 0.028), dust)
    far = np.hypot(x - 0.36, z - 0.12)
    dial = (part == "case") & (far < 0.225) & (y < -0.2)
    angle = np.arctan2(z - 0.12, x - 0.36)
    marks = step(np.cos(24 * angle), 0.75, 0.2) * step(far, 0.14, 0.01)
    colour = np.where(dial[:, None], mix((0.66, 0.56, 0.36), (0.25, 0.05, 0.03), marks), colour)
    rough = np.where(dial, 0.45, mix(0.12, 0.21, dust))
    rough = np.where(part == "knob", 0.3, np.where(part == "foot", 0.7, rough))
    return colour, rough, np.zeros(len(p))


def mug() -> list[Solid]:
    """A glazed mug with an ear, a finger's breadth of tea in it."""
    body = turned(
        "body", [(0, 0), (0.30, 0)], smooth((0.30, 0), (0.38, 0.03), (0.42, 0.30), (0.40, 0.70), (0.41, 0.92)),
        smooth((0.41, 0.92), (0.395, 0.935), (0.37, 0.92)), smooth((0.37, 0.92), (0.365, 0.70), (0.37, 0.62)),
        [(0.37, 0.62), (0, 0.62)],
    )  # fmt: skip
    ear = curve([(0.39, 0, 0.74), (0.60, 0, 0.78), (0.66, 0, 0.52), (0.56, 0, 0.26), (0.40, 0, 0.24)], 40)
    return [body, tube("ear", ear, 0.05, sides=20)]


def paint_mug(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    z, far = p[:, 2], np.hypot(p[:, 0], p[:, 1])
    inside = (part == "body") & (far < 0.385) & (z > 0.3)
    tea = inside & (n[:, 2] > 0.8) & (z < 0.7)
    speck = step(noise(p, 22, 41, 2), 0.45, 0.1)
    outer = mix((0.10, 0.22, 0.24), (0.55, 0.50, 0.38), step(np.sin(z * 26 + 0.6 * np.sin(3 * p[:, 0])), 0.2, 0.15))
    outer = mix(outer, (0.05, 0.05, 0.05), 0.6 * speck)
    glaze = np.where(inside[:, None], (0.70, 0.68, 0.62), outer)
    colour = np.where(tea[:, None], (0.10, 0.035, 0.008), glaze)
    return colour, np.where(tea, 0.08, 0.18), np.zeros(len(p))


def tin() -> list[Solid]:
    """A closed tin: a flat lid of plain bright metal behind a low rim, a printed band around it."""
    side = [(0.52, 0.02), (0.52, 0.60)]
    rim = smooth((0.52, 0.60), (0.545, 0.615), (0.545, 0.64), (0.525, 0.655), (0.505, 0.64), (0.50, 0.625))
    foot = smooth((0.50, 0), (0.515, 0.005), (0.52, 0.02), count=8)
    return [turned("tin", [(0, 0), (0.50, 0)], foot, side, rim, [(0.50, 0.625), (0, 0.625)], sides=96)]


def paint_tin(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    z, angle = p[:, 2], np.arctan2(p[:, 1], p[:, 0])
    band = step(np.abs(z - 0.31), 0.24, 0.004) < 0.5
    print_ = mix((0.45, 0.06, 0.05), (0.75, 0.66, 0.45), step(np.sin(9 * angle) * np.sin(14 * z), 0.15, 0.1))
    print_ = mix(print_, (0.04, 0.06, 0.12), step(noise(p, 6, 61, 3), 0.25, 0.05))
    metal = mix((0.62, 0.61, 0.58), (0.74, 0.73, 0.70), 0.5 + 0.5 * noise(p, 14, 67, 2))
    colour = np.where(band[:, None], print_, metal)
    return colour, np.where(band, 0.35, 0.22), np.where(band, 0.0, 1.0)


SCENES = {
    "mug": Recipe(mug, paint_mug, ("interior", 30), 380, heights=(-0.3, 0.92), level=9.0),
    "tin": Recipe(tin, paint_tin, ("sunset", 140), 390, heights=(-0.3, 0.93)),
    "vase": Recipe(vase, paint_vase, ("interior", 90), 310, heights=(-0.3, 0.9), level=11.0),
    "blocks": Recipe(blocks, paint_blocks, ("sunset", 20), 320, heights=(-0.35, 0.92)),
    "lantern": Recipe(lantern, paint_lantern, ("interior", 250), 330, heights=(-0.4, 0.9)),
    "boulder": Recipe(boulder, paint_boulder, ("day", 91), 340, heights=(-0.35, 0.92), wander=True),
    "niche": Recipe(niche, paint_niche, ("sunrise", 60), 350, heights=(-0.35, 0.9)),
    "radio": Recipe(radio, paint_radio, ("studio", 95), 370, heights=(-0.3, 0.93), level=13.0),
    "wheel": Recipe(wheel, paint_wheel, ("studio", 92), 360, heights=(-0.35, 0.9)),
}
