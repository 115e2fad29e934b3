"""Little or no texture: a sculpture of one colour, dark glossy plastic."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.kinds import Recipe
from benchmarks.scenes.objects.mixed import ring
from benchmarks.scenes.paint import mix, noise, step
from benchmarks.scenes.shapes import Solid, blend, block, capsule, carve, ellipsoid, level_set, tube, turn


def idol() -> list[Solid]:
    """A seated figure, smooth, hands on its knees, on a round base with a relief."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        body = ellipsoid(p, (0, 0, -0.05), (0.36, 0.27, 0.46))
        body = blend(body, ellipsoid(p, (0, 0.02, 0.28), (0.40, 0.22, 0.2)), 0.12)
        head = blend(
            ellipsoid(p, (0, -0.06, 0.68), (0.22, 0.25, 0.29)), ellipsoid(p, (0, -0.28, 0.63), (0.045, 0.09, 0.1)), 0.06
        )
        for side in (-1, 1):
            head = carve(head, ellipsoid(p, (0.09 * side, -0.30, 0.72), (0.06, 0.06, 0.035)), 0.03)
            head = blend(head, ellipsoid(p, (0.23 * side, -0.02, 0.66), (0.03, 0.07, 0.12)), 0.03)
            arm = capsule(p, (0.40 * side, 0.02, 0.30), (0.50 * side, -0.06, -0.10), 0.10)
            arm = blend(arm, capsule(p, (0.50 * side, -0.06, -0.10), (0.30 * side, -0.50, -0.24), 0.085), 0.06)
            leg = capsule(p, (0.20 * side, -0.08, -0.40), (0.30 * side, -0.56, -0.38), 0.15)
            leg = blend(leg, capsule(p, (0.30 * side, -0.56, -0.38), (0.26 * side, -0.50, -0.84), 0.11), 0.06)
            body = blend(body, blend(arm, leg, 0.04), 0.07)
        crown = np.hypot(np.hypot(x, y + 0.03) - 0.17, z - 0.90) - 0.05 - 0.015 * np.cos(9 * np.arctan2(y + 0.03, x))
        figure = blend(
            blend(body, capsule(p, (0, 0, 0.4), (0, -0.03, 0.55), 0.13), 0.08), blend(head, crown, 0.04), 0.04
        )
        folds = np.exp(-(((z + 0.1) / 0.25) ** 2)) * 0.012 * np.sin(40 * z + 6 * x * x)
        round_ = np.hypot(x, y + 0.15)
        base = np.maximum(round_ - 0.72, np.abs(z + 0.93) - 0.1)
        base = base - 0.018 * np.cos(18 * np.arctan2(y + 0.15, x)) * (round_ > 0.5)
        stool = np.maximum(np.hypot(x, y - 0.08) - 0.34, np.abs(z + 0.68) - 0.2)
        return blend(blend(figure + folds, stool, 0.05), base, 0.05)

    return [level_set("idol", distance, 1.12, cells=150, faces=26000)]


def paint_idol(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    return np.broadcast_to((0.52, 0.46, 0.38), p.shape), np.full(len(p), 0.55), np.zeros(len(p))


def phone() -> list[Solid]:
    """A table telephone of black plastic, with a dial of ten holes and its receiver on the rest."""

    def distance(p: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(p, -1, 0)
        wide = 0.62 - 0.28 * (z + 0.4)
        body = np.maximum(block(p, (0, 0.05, -0.15), (0.62, 0.56, 0.32), 0.08), (np.abs(x) - wide) * 0.9)
        slope = -0.714 * (y + 0.51) + 0.70 * (z + 0.30)
        body = -blend(-body, -slope, 0.06)
        rest = block(p, (0, 0.2, 0.24), (0.26, 0.2, 0.16), 0.06)
        body = blend(body, rest, 0.06)
        for side in (-1, 1):
            body = blend(body, block(p, (0.24 * side, 0.2, 0.42), (0.045, 0.17, 0.1), 0.03), 0.03)
        arch = 0.10 * (1 - (x / 0.62) ** 2)
        middle = np.stack([x, y - 0.2, z - 0.43 - arch], -1)
        bar = block(middle, (0, 0, 0), (0.60, 0.075, 0.06), 0.05)
        ends = [ellipsoid(p, (0.62 * s, 0.2, 0.38), (0.17, 0.17, 0.11)) for s in (-1, 1)]
        receiver = blend(bar, np.minimum(*ends), 0.08)
        around, up = DIAL
        q = (p - np.array(up)) @ around
        dial = np.maximum(np.hypot(q[..., 0], q[..., 1]) - 0.30, np.abs(q[..., 2]) - 0.045)
        for k in range(10):
            angle = np.radians(60 + 27 * k)
            hole = np.hypot(q[..., 0] - 0.215 * np.cos(angle), q[..., 1] - 0.215 * np.sin(angle)) - 0.047
            dial = carve(dial, np.maximum(hole, -(q[..., 2] - 0.012)), 0.01)
        return np.minimum(blend(body, dial, 0.02), receiver)

    spiral = np.linspace(0, 1, 300)
    cord = np.stack([-0.66 - 0.10 * np.sin(np.pi * spiral), 0.2 + 0.35 * spiral, 0.30 - 0.62 * spiral], -1)
    coil = 0.045 * np.stack([np.cos(110 * spiral), np.sin(110 * spiral), 0.3 * np.sin(110 * spiral)], -1)
    feet = [
        tube("foot", ring((0.4 * x, 0.05 + 0.4 * y, -0.47), 0.05, 24), 0.035, closed=True)
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    return [level_set("phone", distance, 1.0, cells=150, faces=26000), tube("cord", cord + coil, 0.02, sides=8), *feet]


#: Axes of the dial (columns: right, up, out) and its middle.
DIAL = (turn(0, 44.6), (0.0, -0.30, -0.045))


def paint_phone(p: np.ndarray, n: np.ndarray, part: np.ndarray) -> tuple:
    around, middle = DIAL
    q = (p - np.array(middle)) @ around
    flat = np.hypot(q[:, 0], q[:, 1])
    card = (flat < 0.12) & (q[:, 2] > 0.03) & (q[:, 2] < 0.08)
    dust = 0.5 + 0.5 * noise(p, 8, 3, 3)
    colour = mix((0.016, 0.016, 0.018), (0.030, 0.030, 0.032), dust)
    lines = step(np.sin(110 * q[:, 1]), 0.6, 0.2) * (np.abs(q[:, 0]) < 0.08) * (np.abs(q[:, 1]) < 0.07)
    colour = np.where(card[:, None], mix((0.72, 0.68, 0.58), (0.1, 0.1, 0.3), lines), colour)
    holes = (flat > 0.16) & (flat < 0.27) & (q[:, 2] > 0.0) & (q[:, 2] < 0.02)
    colour = np.where(holes[:, None], (0.62, 0.60, 0.54), colour)
    rough = np.where(part == "cord", 0.5, mix(0.13, 0.2, dust))
    return colour, np.where(card, 0.5, np.where(part == "foot", 0.7, rough)), np.zeros(len(p))


SCENES = {
    "idol": Recipe(idol, paint_idol, ("studio", 71), 120, heights=(-0.3, 0.9), texels=512),
    "phone": Recipe(phone, paint_phone, ("studio", 7), 220, heights=(-0.25, 0.93), level=13.0),
}
