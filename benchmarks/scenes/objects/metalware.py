"""Six scenes of metal for choosing: a saucepan, a goblet and a tankard, which are open; a drum, an ingot and a cash
box, which are not, whatever their flat tops mirror."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import coat, mix, noise, step
from benchmarks.scenes.shapes import Solid, ball, box, rod, smooth, tube, turned


def saucepan() -> list[Solid]:
    """A copper saucepan, tinned inside, with a long iron handle."""
    pan = turned(
        "copper", [(0, 0), (0.55, 0)], smooth((0.55, 0), (0.60, 0.02), (0.62, 0.07), (0.62, 0.52), count=32),
        smooth((0.62, 0.52), (0.64, 0.54), (0.63, 0.56), (0.60, 0.55), (0.59, 0.53), count=16),
        smooth((0.59, 0.53), (0.59, 0.08), (0.57, 0.04), (0.53, 0.03), count=32), [(0.53, 0.03), (0, 0.03)],
        sides=112,
    )  # fmt: skip
    handle = curve([(0.60, 0, 0.42), (0.80, 0, 0.46), (1.15, 0, 0.60), (1.45, 0, 0.66)], 40)
    found = [pan, tube("iron", handle, np.linspace(0.045, 0.06, len(handle)), sides=20)]
    found.append(tube("iron", np.array([1.50, 0, 0.67]) + ring((0, 0, 0), 0.075, 40)[:, [0, 2, 1]], 0.022, closed=True))
    for y in (-0.09, 0.09):
        found += [
            rod("iron", (0.60, y, 0.40), (0.665, y, 0.40), 0.03),
            ball("iron", (0.66, y, 0.40), (0.02, 0.03, 0.03)),
        ]
    found.append(box("iron", (0.012, 0.13, 0.05), 0.01).moved((0.635, 0, 0.40)))
    return found


def paint_saucepan(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    inside = (np.hypot(p[:, 0], p[:, 1]) < 0.606) & (p[:, 2] > 0.02)
    copper = mix([0.80, 0.42, 0.28], [0.92, 0.58, 0.42], 0.5 + 0.5 * noise(p, 5, 2, 3))
    copper = mix(copper, [0.30, 0.14, 0.09], step(noise(p, 3, 8, 4) - 0.8 * p[:, 2], -0.05, 0.2))
    tin = mix([0.50, 0.49, 0.46], [0.66, 0.65, 0.62], 0.5 + 0.5 * noise(p, 12, 4, 3))
    base, rough, metal = coat(
        part, (("copper", np.where(inside[:, None], tin, copper), 0.26, 1), ("iron", [0.10, 0.10, 0.10], 0.55, 1))
    )
    return base, np.where(inside & (part == "copper"), 0.38, rough), metal


def goblet() -> list[Solid]:
    """A brass goblet on a thin stem with a knot, its bowl deep and open."""
    cup = turned(
        "brass", [(0, 0), (0.36, 0)], smooth((0.36, 0), (0.37, 0.02), (0.30, 0.06), (0.10, 0.12), (0.06, 0.25)),
        smooth((0.06, 0.25), (0.06, 0.34), (0.13, 0.40), (0.06, 0.46), (0.06, 0.52)),
        smooth((0.06, 0.52), (0.20, 0.60), (0.36, 0.80), (0.41, 1.05), (0.40, 1.30), count=40),
        smooth((0.40, 1.30), (0.395, 1.315), (0.38, 1.305), count=8),
        smooth((0.38, 1.305), (0.385, 1.05), (0.335, 0.82), (0.18, 0.64), (0.0, 0.58), count=48), sides=112,
    )  # fmt: skip
    found = [cup, *(tube("brass", ring((0, 0, z), wide, 96), 0.012, closed=True) for z, wide in BANDS)]
    for k in range(12):
        a = 2 * np.pi * k / 12
        found.append(ball("stone", (0.415 * np.cos(a), 0.415 * np.sin(a), 1.06), (0.035, 0.035, 0.045), sides=24))
    return found


BANDS = (1.18, 0.41), (0.94, 0.395)


def paint_goblet(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    angle, z = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    brass = mix([0.66, 0.48, 0.18], [0.80, 0.62, 0.28], 0.5 + 0.5 * noise(p, 8, 5, 3))
    cut = step(np.sin(8 * angle) * np.sin(26 * z), 0.4, 0.15) * (z > 0.6) * (np.hypot(p[:, 0], p[:, 1]) > 0.2)
    base, rough, metal = coat(
        part, (("brass", mix(brass, [0.34, 0.22, 0.09], cut), 0.24, 1), ("stone", [0.35, 0.02, 0.03], 0.12, 0))
    )
    return base, np.where(part == "brass", mix(0.24, 0.5, cut), rough), metal


def tankard() -> list[Solid]:
    """A tankard of brushed steel with a handle of wire."""
    cup = turned(
        "steel", [(0, 0), (0.40, 0)], smooth((0.40, 0), (0.44, 0.02), (0.45, 0.06), (0.45, 0.86), count=32),
        smooth((0.45, 0.86), (0.472, 0.875), (0.47, 0.90), (0.445, 0.90), (0.43, 0.88), count=16),
        smooth((0.43, 0.88), (0.43, 0.07), (0.42, 0.04), (0.38, 0.03), count=32), [(0.38, 0.03), (0, 0.03)], sides=112,
    )  # fmt: skip
    wire = [(0.44, 0.12, 0.72), (0.70, 0.11, 0.72), (0.78, 0.08, 0.62), (0.72, 0.03, 0.30), (0.66, 0, 0.24)]
    half = curve(wire, 40)
    other = half[::-1] * [1, -1, 1]
    return [cup, tube("steel", np.concatenate([half, other[1:]]), 0.024, sides=16)]


def paint_tankard(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    steel = mix([0.50, 0.50, 0.49], [0.62, 0.61, 0.60], 0.5 + 0.5 * noise(p * [3, 3, 60], 1.0, 3, 2))
    worn = step(noise(p, 7, 9, 4), 0.35, 0.2)
    return mix(steel, [0.36, 0.34, 0.32], worn), mix(0.3, 0.5, worn), np.ones(len(p))


def drum() -> list[Solid]:
    """A closed drum of steel, painted around, its flat top bright, two hoops and a bung on it."""
    body = turned(
        "drum", [(0, 0), (0.55, 0)], smooth((0.55, 0), (0.575, 0.01), (0.57, 0.04), count=8),
        [(0.57, 0.04), (0.57, 1.1)],
        smooth((0.57, 1.1), (0.585, 1.12), (0.575, 1.14), (0.55, 1.13), (0.545, 1.115), count=12),
        [(0.545, 1.115), (0, 1.115)], sides=112,
    )  # fmt: skip
    found = [body, *(tube("drum", ring((0, 0, z), 0.57, 112), 0.022, closed=True) for z in (0.38, 0.76))]
    return [*found, rod("bung", (0.36, 0.1, 1.10), (0.36, 0.1, 1.15), 0.07, sides=32)]


def paint_drum(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    angle, z = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    paint = mix([0.02, 0.16, 0.26], [0.72, 0.66, 0.52], step(np.abs(z - 0.57), 0.19, 0.01) < 0.5)
    rust = step(noise(p, 4, 11, 4) + 0.1 * np.sin(5 * angle), 0.36, 0.1)
    top = z > 1.108
    steel = mix([0.56, 0.55, 0.53], [0.66, 0.65, 0.63], 0.5 + 0.5 * noise(p, 9, 6, 3))
    colour = np.where(top[:, None], steel, mix(paint, [0.26, 0.11, 0.05], rust))
    metal = np.where(top, 1.0, 0.0)
    base = np.where((part == "bung")[:, None], [0.70, 0.55, 0.25], colour)
    return base, np.where(top, 0.2, mix(0.4, 0.85, rust)), np.where(part == "bung", 1.0, metal)


def ingot() -> list[Solid]:
    """A cast bar of gold, narrower above, with a frame and a stamp on its top."""
    bar = box("gold", (0.95, 0.42, 0.26), 0.06).moved((0, 0, 0.26))
    found = [Solid(bar.name, tuple(replace(chart, points=_narrower(chart.points)) for chart in bar.charts))]
    corners = np.array([[-0.72, -0.26], [0.72, -0.26], [0.72, 0.26], [-0.72, 0.26], [-0.72, -0.26]])
    frame = np.concatenate([np.linspace(a, b, 30)[:-1] for a, b in pairwise(corners)])
    found.append(tube("gold", np.column_stack([frame, np.full(len(frame), 0.52)]), 0.035, sides=16, closed=True))
    found.append(rod("gold", (0.2, 0, 0.50), (0.2, 0, 0.545), 0.14, sides=48))
    found += [box("gold", (0.05, 0.10, 0.02), 0.01).moved((x, 0, 0.53)) for x in (-0.45, -0.3, -0.15)]
    return found


def _narrower(points: np.ndarray) -> np.ndarray:
    return points * np.column_stack([1 - 0.14 * points[:, 2], 1 - 0.3 * points[:, 2], np.ones(len(points))])


def paint_ingot(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    gold = mix([0.86, 0.62, 0.22], [0.95, 0.74, 0.34], 0.5 + 0.5 * noise(p, 6, 3, 3))
    return gold, mix(0.2, 0.36, 0.5 + 0.5 * noise(p, 10, 7, 3)), np.ones(len(p))


def cashbox() -> list[Solid]:
    """A cash box of brushed aluminium: a flat lid with a wire handle, a lock, blue sides."""
    found = [box("side", (0.75, 0.55, 0.26), 0.03), box("lid", (0.77, 0.57, 0.06), 0.025).moved((0, 0, 0.30))]
    handle = curve(
        [(-0.30, 0, 0.34), (-0.30, 0, 0.46), (-0.2, 0, 0.52), (0.2, 0, 0.52), (0.30, 0, 0.46), (0.30, 0, 0.34)], 60
    )
    found.append(tube("wire", handle, 0.025, sides=16))
    found.append(rod("lock", (0, -0.53, 0.05), (0, -0.585, 0.05), 0.07, sides=40))
    return found


def paint_cashbox(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    brushed = mix([0.62, 0.62, 0.63], [0.76, 0.76, 0.77], 0.5 + 0.5 * noise(p * [3, 50, 3], 1.0, 3, 2))
    scratch = step(noise(p * [18, 4, 4], 1.0, 9, 3), 0.4, 0.1)
    blue = mix([0.03, 0.08, 0.30], [0.05, 0.12, 0.38], 0.5 + 0.5 * noise(p, 15, 5, 2))
    return coat(part, (
        ("side", mix(blue, [0.5, 0.5, 0.5], 0.6 * scratch), 0.3, 0), ("lid", brushed, 0.22, 1),
        ("wire", [0.60, 0.60, 0.60], 0.25, 1), ("lock", [0.74, 0.56, 0.24], 0.3, 1),
    ))  # fmt: skip


SCENES = {
    "saucepan": Recipe(saucepan, paint_saucepan, ("interior", 60), 680, heights=(-0.3, 0.93), level=9.0),
    "goblet": Recipe(goblet, paint_goblet, ("night", 120), 690, heights=(-0.3, 0.93)),
    "tankard": Recipe(tankard, paint_tankard, ("overcast", 21), 700, heights=(-0.3, 0.93)),
    "drum": Recipe(drum, paint_drum, ("studio", 33), 710, heights=(-0.3, 0.93)),
    "ingot": Recipe(ingot, paint_ingot, ("sunrise", 200), 720, heights=(-0.2, 0.95)),
    "cashbox": Recipe(cashbox, paint_cashbox, ("interior", 200), 730, heights=(-0.3, 0.93), level=9.0),
}
