"""Three small scenes for choosing (256 pixels): a ship under sail, a frying pan, a head by night."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.paint import coat, mix, noise, step
from benchmarks.scenes.shapes import (
    Chart,
    Solid,
    ball,
    blend,
    box,
    capsule,
    carve,
    ellipsoid,
    grid,
    level_set,
    rod,
    smooth,
    tube,
    turn,
    turned,
)


def ship() -> list[Solid]:
    """A hull that is open above, two masts with sails a hundredth thick, shrouds and stays."""

    def hull(p: np.ndarray) -> np.ndarray:
        x, _, z = np.moveaxis(p, -1, 0)
        sheer = 0.10 * x**2
        body = ellipsoid(p, (0, 0, -0.35), (1.02, 0.30, 0.36))
        body = np.maximum(body, z + 0.36 - sheer)
        inside = ellipsoid(p, (0, 0, -0.32), (0.92, 0.24, 0.26))
        return carve(body, np.maximum(inside, -(z + 0.47 - sheer)), 0.01)

    found = [level_set("hull", hull, 1.15, cells=200, faces=24000)]
    keel = tube("keel", np.array([[-0.8, 0, -0.64], [-0.4, 0, -0.70], [0.4, 0, -0.70], [0.82, 0, -0.62]]), 0.03)
    found += [keel, box("cabin", (0.17, 0.13, 0.09), 0.02).moved((-0.52, 0, -0.38))]
    for x, high in ((0.34, 0.95), (-0.26, 0.85)):
        found.append(rod("spar", (x, 0, -0.5), (x, 0, high), 0.026))
        for low, top, wide in ((-0.22, 0.30, 0.44), (0.36, 0.78, 0.32)):
            found.append(rod("spar", (x + 0.03, -wide, top), (x + 0.03, wide, top), 0.016, sides=10))
            found.append(_sail(x + 0.045, low, top, wide, 0.85 * wide))
        for side in (-1, 1):
            for k in range(4):
                foot = (x - 0.12 + 0.08 * k, side * (0.27 - 0.16 * (x - 0.12 + 0.08 * k) ** 2), -0.36)
                found.append(rod("rope", foot, (x, 0, 0.62), 0.008, sides=8))
    found.append(rod("spar", (0.80, 0, -0.32), (1.18, 0, -0.10), 0.022))
    found += [
        rod("rope", (1.14, 0, -0.12), (0.34, 0, 0.88), 0.008, sides=8),
        rod("rope", (0.34, 0, 0.92), (-0.26, 0, 0.80), 0.008, sides=8),
        rod("rope", (-0.26, 0, 0.82), (-0.92, 0, -0.26), 0.008, sides=8),
    ]
    return found


def _sail(x: float, low: float, top: float, below: float, above: float, thick: float = 0.010) -> Solid:
    """A square sail that the wind fills towards +x."""
    s, t = np.meshgrid(np.linspace(0, 1, 25), np.linspace(-1, 1, 33), indexing="ij")
    belly = 0.15 * np.sin(np.pi * (0.12 + 0.76 * s)) * (1 - 0.75 * t**2)
    middle = np.stack([x + belly, t * (below + (above - below) * s), low + (top - low) * s], -1)
    up = np.cross(np.gradient(middle, axis=1), np.gradient(middle, axis=0))
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    front, back = middle + 0.5 * thick * up, middle - 0.5 * thick * up
    charts: list[Chart] = [grid(front, up), grid(back, -up)]
    for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        out = middle[edge] - middle.mean((0, 1))
        out -= (out * up[edge]).sum(-1, keepdims=True) * up[edge]
        out /= np.linalg.norm(out, axis=-1, keepdims=True)
        charts.append(grid(np.stack([front[edge], back[edge]]), np.stack([out, out])))
    return Solid("sail", tuple(charts))


def paint_ship(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    grain = 0.5 + 0.5 * noise(p * [1, 6, 6], 5, 2, 3)
    planks = step(np.abs(np.sin(46 * p[:, 2])), 0.10, 0.05)
    wood = mix([0.16, 0.08, 0.03], mix([0.42, 0.22, 0.09], [0.30, 0.15, 0.06], grain), planks)
    stripe = (np.abs(p[:, 2] + 0.44 - 0.08 * p[:, 0] ** 2) < 0.03) & (np.abs(n[:, 1]) > 0.3)
    wood = np.where(stripe[:, None], [0.60, 0.50, 0.20], wood)
    cross = (np.abs(p[:, 1]) < 0.05) | (np.abs(p[:, 2] - 0.04) < 0.05)
    cloth = mix([0.74, 0.69, 0.56], [0.62, 0.56, 0.44], 0.5 + 0.5 * noise(p, 5, 8, 3))
    sail = np.where((cross & (p[:, 2] < 0.34))[:, None], [0.50, 0.06, 0.05], cloth)
    return coat(part, (
        ("hull", wood, 0.45, 0), ("keel", [0.14, 0.07, 0.03], 0.5, 0),
        ("cabin", 0.5 * wood + [0.25, 0.15, 0.08], 0.4, 0),
        ("spar", [0.45, 0.28, 0.12], 0.4, 0), ("sail", sail, 0.85, 0), ("rope", [0.30, 0.24, 0.15], 0.9, 0),
    ))  # fmt: skip


def pan() -> list[Solid]:
    """A frying pan: brushed steel outside, a dark coat inside, a handle of black plastic on a steel bracket."""
    body = turned(
        "outside",
        [(0.0, -0.20), (0.50, -0.20)],
        smooth((0.50, -0.20), (0.58, -0.17), (0.72, 0.03), (0.74, 0.06)),
        [(0.74, 0.06), (0.72, 0.065)],
        smooth((0.72, 0.065), (0.70, 0.04), (0.56, -0.14), (0.49, -0.165)),
        [(0.49, -0.165), (0.0, -0.165)],
        sides=128,
    )
    line = np.array([[0.66, 0, -0.03], [0.80, 0, 0.02], [0.95, 0, 0.10], [1.0, 0, 0.12]])
    grip = np.array([[0.97, 0, 0.11], [1.15, 0, 0.19], [1.4, 0, 0.25], [1.62, 0, 0.26]])
    smooth_grip = np.column_stack([np.interp(np.linspace(0, 1, 40), np.linspace(0, 1, 4), c) for c in grip.T])
    thick = 0.055 + 0.018 * np.sin(np.linspace(0, np.pi, 40))
    thick[-6:] *= np.sqrt(np.linspace(1, 0.1, 6))
    found = [body, tube("bracket", line, 0.035, sides=18), tube("grip", smooth_grip, thick, sides=24)]
    for side in (-1, 1):
        a = 0.11 * side
        found.append(ball("rivet", (0.645 * np.cos(a), 0.645 * np.sin(a), -0.03), (0.03, 0.03, 0.03), sides=24))
    found.append(tube("rivet", ring((1.56, 0, 0.262), 0.045, 40), 0.016, sides=12, closed=True))
    top = smooth((0.20, -0.17), (0.21, -0.155), (0.10, -0.14), (0.0, -0.14))
    egg = turned("white", [(0.0, -0.17), (0.20, -0.17)], top, sides=60)
    yolk = ball("yolk", (-0.12, 0.10, -0.135), (0.075, 0.075, 0.05), sides=36)
    found += [egg.moved((-0.13, 0.09, 0)), yolk]
    return [part.moved((-0.40, 0, 0)) for part in found]


def paint_pan(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    radius = np.hypot(p[:, 0] + 0.40, p[:, 1])
    inside = (part == "outside") & (n[:, 2] > 0.05) & (radius < 0.705)
    burnt = mix([0.58, 0.56, 0.54], [0.30, 0.20, 0.13], step(noise(p, 4, 5, 3), 0.25, 0.25) * 0.7)
    base, rough, metal = coat(part, (
        ("outside", burnt, 0.30, 1), ("bracket", [0.60, 0.60, 0.60], 0.25, 1), ("grip", [0.025, 0.025, 0.027], 0.35, 0),
        ("rivet", [0.62, 0.62, 0.62], 0.22, 1), ("white", [0.82, 0.80, 0.74], 0.25, 0),
        ("yolk", [0.82, 0.42, 0.03], 0.15, 0),
    ))  # fmt: skip
    specks = step(noise(p, 40, 6, 1), 0.45, 0.1)
    base[inside] = mix([0.035, 0.035, 0.038], [0.12, 0.12, 0.12], specks)[inside]
    rough[inside], metal[inside] = 0.28, 0
    return base, rough, metal


def head() -> list[Solid]:
    """A head with a cap and a scarf, one body, by the lamps of a street at night."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        skull = blend(
            ellipsoid(p, (0, 0.06, 0.22), (0.40, 0.46, 0.46)), ellipsoid(p, (0, -0.14, -0.02), (0.30, 0.34, 0.40)), 0.12
        )
        nose = blend(
            capsule(p, (0, -0.45, 0.20), (0, -0.60, -0.02), 0.045),
            ellipsoid(p, (0, -0.55, -0.04), (0.09, 0.07, 0.05)),
            0.05,
        )
        face = blend(skull, nose, 0.06)
        for side in (-1, 1):
            face = carve(face, ellipsoid(p, (0.15 * side, -0.50, 0.17), (0.11, 0.12, 0.065)), 0.06)
            face = blend(face, ellipsoid(p, (0.15 * side, -0.38, 0.16), (0.085, 0.085, 0.07)), 0.015)
            face = blend(face, capsule(p, (0.05 * side, -0.48, 0.28), (0.26 * side, -0.40, 0.27), 0.03), 0.05)
            ear = carve(
                ellipsoid(p, (0.41 * side, 0.06, 0.10), (0.06, 0.12, 0.17)),
                ellipsoid(p, (0.46 * side, 0.02, 0.10), (0.05, 0.07, 0.11)),
                0.03,
            )
            face = blend(face, ear, 0.04)
        lips = blend(
            ellipsoid(p, (0, -0.45, -0.16), (0.13, 0.06, 0.03)),
            ellipsoid(p, (0, -0.44, -0.22), (0.11, 0.06, 0.035)),
            0.015,
        )
        face = blend(face, lips, 0.03)
        neck = blend(face, capsule(p, (0, 0.08, -0.2), (0, 0.10, -0.62), 0.20), 0.10)
        scarf = np.hypot(np.hypot(x, y - 0.09) - 0.25 - 0.02 * np.sin(8 * np.arctan2(y, x)), (z + 0.52) * 0.8) - 0.10
        chest = ellipsoid(p, (0, 0.14, -0.95), (0.62, 0.34, 0.36))
        chest = np.maximum(chest, -0.95 - z)
        return blend(blend(neck, chest, 0.10), scarf - 0.008 * np.sin(60 * z + 20 * x), 0.02)

    brim = turned("cap", [(0, 0.395), (0.5, 0.395)], smooth((0.5, 0.395), (0.55, 0.41), (0.5, 0.43)),
                  smooth((0.5, 0.43), (0.44, 0.55), (0.28, 0.70), (0.0, 0.75)), sides=96)  # fmt: skip
    return [level_set("skin", distance, 1.15, cells=200, faces=40000), brim.moved((0, 0.06, 0.06), turn(0, 6))]


def paint_head(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    x, y, z = p.T
    flush = np.exp(-(((np.abs(x) - 0.2) / 0.1) ** 2) - ((z + 0.03) / 0.1) ** 2) * (y < -0.2)
    skin = mix(
        mix([0.60, 0.36, 0.25], [0.52, 0.29, 0.19], 0.5 + 0.5 * noise(p, 9, 3, 3)), [0.60, 0.22, 0.16], 0.6 * flush
    )
    lips = (np.abs(x) < 0.13) & (np.abs(z + 0.19) < 0.055) & (y < -0.40)
    skin = np.where(lips[:, None], [0.45, 0.12, 0.11], skin)
    eye = (np.hypot(np.abs(x) - 0.15, (z - 0.16)) < 0.062) & (y < -0.36)
    iris = (np.hypot(np.abs(x) - 0.15, (z - 0.16)) < 0.028) & (y < -0.36)
    skin = np.where(eye[:, None], [0.70, 0.68, 0.64], skin)
    skin = np.where(iris[:, None], [0.05, 0.10, 0.12], skin)
    wool = mix([0.10, 0.16, 0.34], [0.55, 0.50, 0.42], step(np.sin(22 * x + 9 * y), 0.2, 0.3))
    scarf = (z < -0.40) & (z > -0.66) & (np.hypot(x, y - 0.09) > 0.215)
    coat_ = mix([0.10, 0.11, 0.09], [0.15, 0.16, 0.13], 0.5 + 0.5 * noise(p, 30, 4, 1))
    cloth = z <= -0.64
    colour = np.where(scarf[:, None], wool, np.where(cloth[:, None], coat_, skin))
    rough = np.where(scarf | cloth, 0.9, np.where(eye, 0.12, 0.42))
    base, gloss, metal = coat(part, (("skin", colour, 0.5, 0), ("cap", [0.09, 0.05, 0.03], 0.35, 0)))
    gloss = np.where(part == "skin", rough, gloss)
    return base, gloss, metal


SCENES = {
    "ship": Recipe(ship, paint_ship, ("sunset", 40), 490, heights=(-0.1, 0.9)),
    "pan": Recipe(pan, paint_pan, ("interior", 90), 500, heights=(-0.5, 0.95)),
    "head": Recipe(head, paint_head, ("night", 17), 510, heights=(-0.3, 0.8)),
}
