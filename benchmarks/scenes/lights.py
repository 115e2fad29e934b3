"""Environments: lat-long maps float32 [H, W, 3] of linear radiance, z up, turned as
in Blender.

u = 0.5 - atan2(y, x) / 2 pi, v = acos(z) / pi; row 0 is +z, the middle column looks along +x. Procedural ones are this
project's own; `world` reads the photographs of rooms and skies that Blender's wheel carries.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from scipy.special import expit

from benchmarks.scenes.paint import noise

HEIGHT = 256
#: Photographs in the wheel of bpy 5.0.1 (CC0, Greg Zaal, Poly Haven; its studiolights/world/license.txt).
WORLDS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
_IN_WHEEL = "bpy/5.0/datafiles/studiolights/world"


def directions(height: int) -> np.ndarray:
    """Unit directions [H, 2 H, 3] of the texel centres."""
    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = (0.5 - (np.arange(2 * height) + 0.5) / (2 * height)) * 2 * np.pi
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def toward(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector; degrees, azimuth from +x to +y."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def sun(seed: int) -> np.ndarray:
    """A clear sky with a sun 2.5 degrees wide, which brings four fifths of the light."""
    rng = np.random.default_rng(seed)
    d = directions(HEIGHT)
    towards = toward(rng.uniform(0, 360), rng.uniform(32, 58))
    up = d[..., 2].clip(0)
    sky = 0.18 * np.array([0.45, 0.7, 1.1]) * (0.6 + 0.8 * (1 - up[..., None]) ** 3)
    ground = 0.09 * np.array([1.0, 0.9, 0.75])
    near = np.degrees(np.arccos(np.clip(d @ towards, -1, 1)))
    disc = expit((1.25 - near) / 0.15)
    solid = 2 * np.pi * (1 - np.cos(np.radians(1.25)))
    value = np.where(d[..., 2:] > 0, sky, ground) + disc[..., None] * 2.2 / solid * np.array([1.0, 0.93, 0.8])
    return value.astype(np.float32)


def overcast(seed: int) -> np.ndarray:
    """The CIE's overcast sky, three times as bright above as at the horizon, with faint clouds."""
    d = directions(HEIGHT)
    clouds = noise(d.reshape(-1, 3), 2.5, seed, 3).reshape(d.shape[:2])
    sky = (1 + 2 * d[..., 2].clip(0)) / 3 * (1.15 + 0.25 * clouds)
    value = np.where(d[..., 2] > 0, sky, 0.16)[..., None] * np.array([0.94, 1.0, 1.06])
    return value.astype(np.float32)


def lamps(seed: int) -> np.ndarray:
    """A dim room with two rectangular lamps, one warm, one cool, some 110 degrees apart."""
    rng = np.random.default_rng(seed)
    d = directions(HEIGHT)
    value = 0.05 * np.array([1.0, 0.85, 0.7]) * (1 + 0.5 * d[..., 2:])
    azimuth = rng.uniform(0, 360)
    for turn, elevation, colour, power in (
        (0, rng.uniform(30, 50), (1.0, 0.78, 0.5), 1.3),
        (rng.uniform(95, 125), rng.uniform(15, 40), (0.7, 0.85, 1.0), 0.8),
    ):  # fmt: skip
        towards = toward(azimuth + turn, elevation)
        right = np.cross([0, 0, 1.0], towards)
        right /= np.linalg.norm(right)
        depth = d @ towards
        x, y = d @ right / depth.clip(1e-6), d @ np.cross(towards, right) / depth.clip(1e-6)
        inside = (depth > 0) * _edge(x, 0.20) * _edge(y, 0.11)
        value = value + inside[..., None] * power / (4 * 0.20 * 0.11) * np.array(colour)
    return value.astype(np.float32)


def _edge(x: np.ndarray, half: float) -> np.ndarray:
    return expit((half - np.abs(x)) / 0.006)


def coloured(seed: int) -> np.ndarray:
    """Three broad lights, magenta, green and amber, from three sides, and a little of everything else."""
    rng = np.random.default_rng(seed)
    d = directions(HEIGHT)
    value = np.full((*d.shape[:2], 3), 0.06)
    azimuth = rng.uniform(0, 360)
    for k, colour in enumerate(((1.0, 0.15, 0.75), (0.1, 0.9, 0.35), (1.0, 0.55, 0.08))):
        towards = toward(azimuth + 120 * k, rng.uniform(10, 60))
        value = value + 2.2 * np.exp(18 * (d @ towards - 1))[..., None] * np.array(colour)
    return value.astype(np.float32)


def studio(seed: int) -> np.ndarray:
    """A bright room with three soft boxes: light to take pictures in."""
    rng = np.random.default_rng(seed)
    d = directions(HEIGHT)
    value = np.broadcast_to(0.30 + 0.12 * d[..., 2:], d.shape) * np.array([1.0, 0.97, 0.92])
    azimuth = rng.uniform(0, 360)
    for k, (elevation, width, power) in enumerate(((45, 0.35, 5.0), (30, 0.25, 3.0), (62, 0.45, 2.2))):
        towards = toward(azimuth + 125 * k + rng.uniform(-15, 15), elevation + rng.uniform(-8, 8))
        right = np.cross([0, 0, 1.0], towards)
        right /= np.linalg.norm(right)
        depth = d @ towards
        x, y = d @ right / depth.clip(1e-6), d @ np.cross(towards, right) / depth.clip(1e-6)
        inside = (depth > 0) * _edge(x, width) * _edge(y, 0.8 * width)
        value = value + power * inside[..., None] * rng.uniform(0.9, 1.05, 3)
    return value.astype(np.float32)


def day(seed: int) -> np.ndarray:
    """A sky with white clouds and a hazy sun 12 degrees wide."""
    rng = np.random.default_rng(seed)
    d = directions(HEIGHT)
    up = d[..., 2].clip(0)
    clouds = noise(d.reshape(-1, 3) * [1, 1, 2.2], 2.2, seed, 4).reshape(d.shape[:2])
    share = expit(9 * (clouds - 0.05))[..., None]
    blue = 0.55 * np.array([0.5, 0.75, 1.15]) * (0.7 + 0.6 * (1 - up[..., None]) ** 3)
    sky = blue + share * (1.2 * np.array([1.0, 0.99, 0.97]) - blue)
    towards = toward(rng.uniform(0, 360), rng.uniform(35, 55))
    near = np.degrees(np.arccos(np.clip(d @ towards, -1, 1)))
    haze = 40 * np.exp(-0.5 * (near / 5.0) ** 2)[..., None] * np.array([1.0, 0.95, 0.85])
    value = np.where(d[..., 2:] > 0, sky, 0.22 * np.array([1.0, 0.95, 0.85])) + haze
    return value.astype(np.float32)


PROCEDURAL: dict[str, Callable[[int], np.ndarray]] = {
    "sun": sun, "overcast": overcast, "lamps": lamps, "coloured": coloured, "studio": studio, "day": day,
}  # fmt: skip


def world(name: str, source: Path | None, turn: int, height: int = HEIGHT) -> np.ndarray:
    """One of WORLDS averaged to [height, 2 height, 3] and turned by whole columns.

    source  the wheel of bpy 5.0.1 as it lies, or a folder with the eight EXR files. Raises ValueError without it.
    """
    if source is None:
        raise ValueError(
            f"the scene is lit by Blender's world picture {name!r}: give --worlds, the wheel of bpy 5.0.1 "
            "(`pip download --no-deps bpy==5.0.1`) or a folder with its studiolights/world/*.exr"
        )
    if source.is_dir():
        return reduced(read_exr(source / f"{name}.exr"), height, turn)
    import tempfile

    with zipfile.ZipFile(source) as wheel, tempfile.TemporaryDirectory() as place:
        return reduced(read_exr(Path(wheel.extract(f"{_IN_WHEEL}/{name}.exr", place))), height, turn)


def reduced(picture: np.ndarray, height: int, turn: int = 0) -> np.ndarray:
    """Means over blocks (a whole number of texels), no negative value, turned by `turn` columns."""
    factor = max(1, picture.shape[0] // height)
    rows, columns = picture.shape[0] // factor, picture.shape[1] // factor
    blocks = picture[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, 3).mean((1, 3))
    return np.ascontiguousarray(np.roll(blocks.clip(0), turn, axis=1), np.float32)


def read_exr(path: Path) -> np.ndarray:
    """float32 [H, W, 3]. Raises ValueError naming the file."""
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ValueError(f"{path}: no such picture, or not one ({oiio.geterror()})")
    size = source.spec()
    pixels = source.read_image(0, 0, 0, 3, oiio.FLOAT)
    source.close()
    return np.asarray(pixels, np.float32).reshape(size.height, size.width, 3)


def heights(worlds: Path | None, seeds: int = 3) -> dict[str, float]:
    """Of each light the mean sine of the elevation that it comes from (`exmesh_graph.shading.envmap.elevation`)."""
    import torch

    from exmesh_graph.shading.envmap import elevation

    found = {name: world(name, worlds, 0) for name in WORLDS} if worlds else {}
    found |= {f"{name} {k}": make(k) for name, make in PROCEDURAL.items() for k in range(seeds)}
    return {name: float(elevation(torch.from_numpy(light).double())) for name, light in found.items()}


def lookup(light: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Radiance [N, 3] from unit directions [N, 3], bilinear between texel centres: the definition of the files."""
    height, width = light.shape[:2]
    x = (0.5 - np.arctan2(towards[:, 1], towards[:, 0]) / (2 * np.pi)) * width - 0.5
    y = np.clip(np.arccos(np.clip(towards[:, 2], -1, 1)) / np.pi * height - 0.5, 0, height - 1)
    column, row = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), height - 2)
    a, b = (x - column)[:, None], (y - row)[:, None]
    left, right = column % width, (column + 1) % width
    above = (1 - a) * light[row, left] + a * light[row, right]
    below = (1 - a) * light[row + 1, left] + a * light[row + 1, right]
    return (1 - b) * above + b * below
