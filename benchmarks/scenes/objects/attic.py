"""Six scenes for choosing: a knot, a basket, a pine cone, chess, a bell, tools."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.objects.thin import curve
from benchmarks.scenes.paint import coat, mix, noise, step, wood
from benchmarks.scenes.shapes import Solid, ball, box, rod, smooth, tube, turn, turned

STAKES, ROWS = 30, 13


def knot() -> list[Solid]:
    """A trefoil of lacquered tube: each part is hidden by another from most sides."""
    t = np.linspace(0, 2 * np.pi, 241)[:-1]
    path = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -1.15 * np.sin(3 * t)]) / 3
    return [tube("tube", path, 0.17, sides=40, closed=True)]


def paint_knot(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    angle, high = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    band = np.sin(9 * angle + 4 * high)
    colour = mix([0.55, 0.03, 0.03], [0.78, 0.72, 0.58], step(band, 0.2, 0.1))
    colour = mix(colour, [0.03, 0.03, 0.04], step(np.sin(27 * angle), 0.8, 0.1) * step(-band, 0, 0.1))
    return colour, mix(0.14, 0.45, step(band, 0.2, 0.1)), np.zeros(len(p))


def basket() -> list[Solid]:
    """A wicker basket with a handle, open above, light through its weave; seven eggs in it."""
    turn_of = np.linspace(0, 2 * np.pi, 8 * STAKES + 1)[:-1]
    found = [turned("floor", [(0, -0.03), (0.50, -0.03)], [(0.50, -0.03), (0.50, 0.03)], [(0.50, 0.03), (0, 0.03)])]
    for k in range(STAKES):
        a = 2 * np.pi * k / STAKES
        out = np.array([np.cos(a), np.sin(a), 0])
        found.append(rod("stake", 0.47 * out, 0.74 * out + [0, 0, 0.72], 0.016, sides=8))
    for row in range(ROWS):
        share = (row + 0.6) / ROWS
        wide = 0.47 + 0.27 * share + 0.026 * np.cos(STAKES / 2 * turn_of + np.pi * row)
        line = np.column_stack([wide * np.cos(turn_of), wide * np.sin(turn_of), np.full(len(wide), 0.72 * share)])
        found.append(tube("weaver", line, 0.021, sides=8, closed=True))
    found.append(tube("rim", ring((0, 0, 0.73), 0.75, 120), 0.04, sides=16, closed=True))
    arc = np.linspace(0, np.pi, 60)
    for side in (-1, 1):  # two strands wound about each other
        twist = 0.035 * np.column_stack([np.zeros(60), side * np.cos(9 * arc), side * np.sin(9 * arc)])
        found.append(
            tube("handle", np.column_stack([0.74 * np.cos(arc), 0 * arc, 0.73 + 0.75 * np.sin(arc)]) + twist, 0.035)
        )
    for k in range(7):
        a, far = 2 * np.pi * k / 6, 0.27 if k < 6 else 0
        found.append(ball(f"egg {k}", (far * np.cos(a), far * np.sin(a), 0.16 + 0.14 * (k == 6)), (0.13, 0.13, 0.16)))
    return found


def paint_basket(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    straw = mix([0.42, 0.26, 0.11], [0.62, 0.44, 0.22], 0.5 + 0.5 * noise(p, 14, 3, 3))
    dyed = mix([0.28, 0.06, 0.05], straw, step(np.abs(p[:, 2] - 0.42), 0.06, 0.01))
    speck = step(noise(p, 26, 8, 2), 0.35, 0.1)
    shells = ([0.76, 0.66, 0.54], [0.62, 0.38, 0.24], [0.70, 0.74, 0.70])
    eggs = [(f"egg {k}", mix(shells[k % 3], [0.20, 0.12, 0.08], speck * (k % 2)), 0.4, 0) for k in range(7)]
    return coat(part, (
        ("floor", straw, 0.7, 0), ("stake", straw, 0.6, 0), ("weaver", dyed, 0.55, 0), ("rim", straw, 0.6, 0),
        ("handle", straw, 0.5, 0), *eggs,
    ))  # fmt: skip


def cone() -> list[Solid]:
    """A pine cone: a hundred and thirty scales that overlap, dark and deep between them, one brown."""
    found = [ball("core", (0, 0, 0), (0.26, 0.26, 0.62), sides=48), rod("stem", (0, 0, -0.6), (0.05, 0, -0.95), 0.06)]
    count = 130
    for k in range(count):
        share = (k + 0.5) / count
        high = -0.62 + 1.26 * share
        body = np.sqrt(max(0.02, 1 - (high / 0.72) ** 2))
        length = 0.16 + 0.20 * body
        scale = ball("scale", (0.62 * length, 0, 0), (length, 0.62 * length * 0.8, 0.032), sides=32)
        tip = ball("tip", (1.52 * length, 0, 0.01), (0.07, 0.085 * (0.6 + 0.6 * body), 0.05), sides=24)
        lift = -12 + 78 * share**1.4
        place = turn(2, 137.507764 * k) @ turn(1, -lift)
        at = turn(2, 137.507764 * k) @ np.array([0.16 * body, 0, high])
        found += [scale.moved(at, place), tip.moved(at, place)]
    return found


def paint_cone(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    grain = 0.5 + 0.5 * noise(p, 18, 4, 3)
    return coat(part, (
        ("core", [0.06, 0.035, 0.02], 0.8, 0), ("stem", [0.20, 0.13, 0.08], 0.8, 0),
        ("scale", mix([0.12, 0.06, 0.03], [0.26, 0.15, 0.08], grain), 0.6, 0),
        ("tip", mix([0.30, 0.19, 0.11], [0.46, 0.33, 0.21], grain), 0.55, 0),
    ))  # fmt: skip


PIECES = ((-0.65, -0.65, "w", 1.0), (-0.09, -0.46, "w", 0.62), (0.46, -0.65, "w", 0.62), (0.28, -0.28, "w", 0.8),
          (0.09, 0.65, "b", 1.0), (-0.28, 0.28, "b", 0.62), (0.65, 0.46, "b", 0.62), (-0.65, 0.46, "b", 0.8),
          (0.65, -0.09, "b", 0.62), (-0.46, -0.09, "w", 0.62))  # fmt: skip


def chess() -> list[Solid]:
    """Ten pieces on a board: black beside white, all lacquered, shadows on squares of two tones."""
    found = [box("board", (0.86, 0.86, 0.06), 0.02).moved((0, 0, -0.06))]
    for x, y, side, size in PIECES:
        top = [(0.05, 0.56), (0.085, 0.62), (0.09, 0.68), (0.06, 0.75), (0.0, 0.77)]
        found.append(
            turned(
                side, [(0, -0.01), (0.135, -0.01)],
                smooth((0.135, -0.01), (0.14, 0.05), (0.11, 0.10), (0.06, 0.22), (0.045, 0.40), (0.05, 0.48)),
                [(0.05, 0.48), (0.095, 0.49)], smooth((0.095, 0.49), (0.10, 0.52), (0.05, 0.56)),
                smooth(*top), sides=56,
            ).scaled(size).moved((x, y, 0))
        )  # fmt: skip
        if size == 1.0:
            found += [
                box(side, (0.018, 0.018, 0.075), 0.006).moved((x, y, 0.83)),
                box(side, (0.06, 0.018, 0.018), 0.006).moved((x, y, 0.85)),
            ]
    return found


def paint_chess(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    odd = (np.floor(p[:, 0] / 0.186) + np.floor(p[:, 1] / 0.186)) % 2
    inside = (np.abs(p[:, :2]) < 0.744).all(1) & (p[:, 2] > -0.01)
    grain = wood(p, 5, axis=0, scale=1.2)
    squares = mix(
        mix([0.10, 0.045, 0.02], [0.20, 0.09, 0.04], grain), mix([0.55, 0.40, 0.22], [0.68, 0.52, 0.30], grain), odd
    )
    board = np.where(inside[:, None], squares, mix([0.14, 0.05, 0.025], [0.24, 0.10, 0.05], grain))
    white = mix([0.66, 0.56, 0.40], [0.76, 0.68, 0.52], wood(p, 7))
    return coat(part, (("board", board, 0.3, 0), ("w", white, 0.22, 0), ("b", [0.022, 0.02, 0.02], 0.18, 0)))


def bell() -> list[Solid]:
    """A bronze bell with bands and patina, hollow with a clapper in it, on a yoke of wood."""
    shell = turned(
        "bell", smooth((0.0, 0.74), (0.22, 0.70), (0.32, 0.55), (0.36, 0.25), (0.44, -0.05), (0.60, -0.32), count=48),
        [(0.60, -0.32), (0.68, -0.36)],
        smooth(
            (0.68, -0.36), (0.66, -0.28), (0.52, -0.02), (0.44, 0.28), (0.40, 0.58), (0.28, 0.78), (0.0, 0.82), count=48
        ),
        sides=120,
    )  # fmt: skip
    found = [
        shell,
        box("yoke", (0.70, 0.09, 0.10), 0.03).moved((0, 0, 0.98)),
        rod("iron", (0, 0, 0.80), (0, 0, 0.92), 0.10),
    ]
    for z, wide in ((0.52, 0.412), (0.30, 0.44), (-0.18, 0.60)):
        found.append(tube("bell", ring((0, 0, z), wide, 96), 0.016, closed=True))
    found += [rod("iron", (0, 0, 0.76), (0.08, 0, -0.22), 0.025), ball("iron", (0.09, 0, -0.28), (0.09, 0.09, 0.10))]
    for x in (-0.62, 0.62):
        found.append(rod("iron", (x, 0, 0.98), (x + np.sign(x) * 0.22, 0, 0.98), 0.045))
    return found


def paint_bell(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    rust = step(noise(p, 4, 6, 4) - 0.5 * p[:, 2], 0.22, 0.15) * (part == "bell")
    bronze = mix([0.62, 0.40, 0.20], [0.74, 0.50, 0.26], 0.5 + 0.5 * noise(p, 9, 2, 2))
    skin = mix(bronze, [0.20, 0.36, 0.30], rust)
    base, rough, metal = coat(part, (
        ("bell", skin, 0.3, 1), ("yoke", mix([0.20, 0.11, 0.05], [0.36, 0.22, 0.11], wood(p, 3, axis=0)), 0.6, 0),
        ("iron", [0.32, 0.30, 0.29], 0.45, 1),
    ))  # fmt: skip
    return base, np.where(part == "bell", mix(0.3, 0.75, rust), rough), np.where(part == "bell", 1 - rust, metal)


def tools() -> list[Solid]:
    """A hammer and a wrench that cross: long, thin, steel beside wood and rubber; little of a picture is object."""
    grip = turned(
        "wood", [(0, -1.05), (0.05, -1.05)],
        smooth((0.05, -1.05), (0.075, -0.98), (0.07, -0.6), (0.05, 0.1), (0.055, 0.72)),
        [(0.055, 0.72), (0, 0.72)], sides=40,
    )  # fmt: skip
    head = [
        rod("steel", (-0.10, 0, 0.60), (0.26, 0, 0.60), 0.085, sides=40),
        rod("steel", (0.24, 0, 0.60), (0.34, 0, 0.60), 0.115, sides=40),
    ]
    for side in (-1, 1):
        claw = curve([(-0.06, 0.03 * side, 0.60), (-0.22, 0.045 * side, 0.59), (-0.36, 0.075 * side, 0.50)], 24)
        head.append(tube("steel", claw, np.linspace(0.06, 0.022, len(claw)), sides=20))
    lay = turn(2, 35) @ turn(1, 90)
    found = [solid.moved((0, 0, 0.12), lay) for solid in (grip, *head)]
    wrench = [box("chrome", (0.78, 0.075, 0.03), 0.015), box("rubber", (0.30, 0.085, 0.04), 0.02)]
    open_ring = np.linspace(0.75, 2 * np.pi - 0.75, 30)
    for end in (-1, 1):
        jaw = np.column_stack([end * (0.90 + 0.15 * np.cos(open_ring)), 0.15 * np.sin(open_ring), 0 * open_ring])
        wrench.append(tube("chrome", jaw, 0.05, sides=20))
    return [*found, *(solid.moved((0, 0, -0.08), turn(2, -40)) for solid in wrench)]


def paint_tools(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    along = (p - [0, 0, 0.12]) @ (turn(2, 35) @ turn(1, 90))
    grain = mix([0.52, 0.32, 0.15], [0.70, 0.48, 0.26], wood(along, 9, scale=2.0))
    handle = mix(grain, [0.65, 0.05, 0.04], step(along[:, 2] * -1, 0.55, 0.01))
    steel = mix([0.42, 0.41, 0.40], [0.56, 0.55, 0.54], 0.5 + 0.5 * noise(p, 11, 3, 3))
    return coat(part, (
        ("wood", handle, 0.35, 0), ("steel", steel, 0.38, 1), ("chrome", [0.62, 0.62, 0.63], 0.2, 1),
        ("rubber", [0.05, 0.09, 0.22], 0.55, 0),
    ))  # fmt: skip


SCENES = {
    "knot": Recipe(knot, paint_knot, ("night", 40), 620, heights=(-0.8, 0.8)),
    "basket": Recipe(basket, paint_basket, ("sunrise", 90), 630, heights=(-0.2, 0.95)),
    "cone": Recipe(cone, paint_cone, ("overcast", 7), 640, heights=(-0.7, 0.9)),
    "chess": Recipe(chess, paint_chess, ("studio", 60), 650, heights=(0.15, 0.95)),
    "bell": Recipe(bell, paint_bell, ("sunset", 100), 660, heights=(-0.7, 0.8)),
    "tools": Recipe(tools, paint_tools, ("day", 9), 670, heights=(-0.8, 0.9)),
}
