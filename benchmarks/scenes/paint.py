"""Patterns at points of a surface: noise, wood, checks, writing."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np

WORDS = (
    "amber", "basin", "cedar", "delta", "ember", "fjord", "grove", "harbour", "island", "juniper", "kettle",
    "lantern", "meadow", "north", "ochre", "pebble", "quarry", "river", "stone", "thistle", "upland", "valley",
    "willow", "yarrow", "zenith", "copper", "bridge", "candle", "driftwood", "evening", "field", "glass",
)  # fmt: skip


def noise(points: np.ndarray, frequency: float, seed: int, octaves: int = 1) -> np.ndarray:
    """Smooth noise in about [-1, 1] at points [N, 3]: values on a lattice, cubic between; each octave half the last."""
    total, weight = np.zeros(len(points)), 0.0
    for octave in range(octaves):
        total += 0.5**octave * _lattice(points * frequency * 2**octave, seed + 101 * octave)
        weight += 0.5**octave
    return total / weight


def _lattice(p: np.ndarray, seed: int) -> np.ndarray:
    table = np.random.default_rng(seed).uniform(-1, 1, (32, 32, 32))
    low = np.floor(p).astype(int)
    part = p - low
    part = part * part * (3 - 2 * part)
    total = np.zeros(len(p))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, part, 1 - part), axis=1)
        total += weight * table[tuple(((low + corner) % 32).T)]
    return total


def mix(a: object, b: object, share: np.ndarray) -> np.ndarray:
    """a where `share` [N] is 0, b where it is 1; colours [3] or [N, 3] give [N, 3], numbers [N]."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    share = share[:, None] if a.ndim and a.shape[-1] == 3 else share
    return a + share * (b - a)


def step(x: np.ndarray, edge: float, width: float) -> np.ndarray:
    """0 below `edge`, 1 above, smooth over `width`."""
    t = np.clip((x - edge) / width + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


def coat(
    part: np.ndarray, rows: Iterable[tuple[str, object, float, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base colour [N, 3], roughness and metallic [N] of points by the part that each is on.

    rows  (name, colour [3] or [N, 3], roughness, metallic); what none names is black, half rough and no metal
    """
    base, rough, metal = np.zeros((len(part), 3)), np.full(len(part), 0.5), np.zeros(len(part))
    for name, colour, gloss, steel in rows:
        mine = part == name
        base[mine] = np.broadcast_to(np.asarray(colour, float), base.shape)[mine]
        rough[mine], metal[mine] = gloss, steel
    return base, rough, metal


def wood(points: np.ndarray, seed: int, *, axis: int = 2, scale: float = 1.0) -> np.ndarray:
    """Grain in [0, 1] of wood whose fibres run along the axis."""
    squeezed = points * scale
    squeezed = np.delete(squeezed, axis, 1) if axis is not None else squeezed
    along = points[:, axis] * scale
    wave = noise(np.column_stack([squeezed, 0.25 * along]), 2.5, seed, 2)
    rings = 0.5 + 0.5 * np.sin(38 * np.linalg.norm(squeezed + 0.4, axis=1) + 5 * wave)
    fibres = noise(np.column_stack([squeezed * 24, along * 1.5]), 1.0, seed + 1, 2)
    return np.clip(0.6 * rings + 0.4 * (0.5 + 0.5 * fibres), 0, 1)


@cache
def writing(lines: tuple[str, ...], columns: int, rows: int, frame: int = 0) -> np.ndarray:
    """A picture [rows, columns] in [0, 1], 1 where ink is: the lines as large as fit. Type: Pillow's Aileron (CC0)."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("L", (columns, rows), 0)
    pen = ImageDraw.Draw(picture)
    tall = (rows - 4 * frame) / len(lines)
    font = ImageFont.load_default(max(4, int(0.8 * tall)))
    widest = max(pen.textlength(line, font) for line in lines)
    room = columns - 8 * frame - 0.04 * columns
    if widest > room:
        font = ImageFont.load_default(max(4, int(0.8 * tall * room / widest)))
    for k, line in enumerate(lines):
        pen.text(((columns - pen.textlength(line, font)) / 2, 2 * frame + k * tall), line, 255, font)
    if frame:
        pen.rectangle((frame, frame, columns - frame, rows - frame), outline=255, width=frame)
    return np.asarray(picture, float) / 255


def sentences(seed: int, count: int, words: int) -> tuple[str, ...]:
    """Lines of words drawn at random, for writing that says nothing."""
    rng = np.random.default_rng(seed)
    return tuple(" ".join(rng.choice(WORDS, words)).capitalize() + "." for _ in range(count))


def printed(picture: np.ndarray, across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The picture [R, C] at places [N] of the unit square, (0, 0) its lower left; 0 outside, bilinear inside."""
    rows, columns = picture.shape
    x, y = across * columns - 0.5, (1 - up) * rows - 0.5
    inside = (across > 0) & (across < 1) & (up > 0) & (up < 1)
    c, r = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros(len(x))
    for i in (0, 1):
        for j in (0, 1):
            weight = np.where(i, y - r, 1 - y + r) * np.where(j, x - c, 1 - x + c)
            total += weight * picture[np.clip(r + i, 0, rows - 1), np.clip(c + j, 0, columns - 1)]
    return np.where(inside, total, 0)
