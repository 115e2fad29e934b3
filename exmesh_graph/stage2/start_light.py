"""The light that a fit starts from: white, brighter above, with a sun where one was found."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

from exmesh_graph.shading import envmap

#: Of the sphere, the share that a key light may take: 25 degrees about one direction.
SPOT = 0.05


class KeyLight(NamedTuple):
    """One small strong light.

    direction  unit [3]
    strength   irradiance of a surface that faces it, over that of level ground under all other light
    reach      half the angle that it spans [degrees]; 0: as small as texels allow
    gain       share that it explains of what neighbouring points differ by (stage2.key_light)
    """

    direction: np.ndarray
    strength: float
    reach: int = 0
    gain: float = 0.0


def white_light(above: float = 0.0, height: int = 32) -> np.ndarray:
    """Radiance 1 + `above` sin(elevation), float32 [height, 2 height, 3]."""
    rows = 1 + above * envmap.sines(height).numpy()
    return np.broadcast_to(rows[:, None, None], (height, 2 * height, 3)).astype(np.float32)


def with_key(environment: np.ndarray, key: KeyLight) -> np.ndarray:
    """`environment` [H, W, 3], an even light, and the key light: on the four texels about its direction, or all that
    are within its reach.

    Level ground under a radiance of 1 has the irradiance pi.
    """
    height, width = environment.shape[:2]
    angle = np.repeat(envmap.solid_angles(height, width), width)
    towards = np.asarray(key.direction, np.float64)
    if key.reach:
        within = envmap.texel_directions(height, width).reshape(-1, 3) @ towards >= math.cos(math.radians(key.reach))
        share = within * angle / (within * angle).sum()
    else:
        index, weight = envmap.bilinear(height, width, *envmap.uv_of(torch.from_numpy(towards[None])))
        share = np.bincount(index[0].numpy(), weights=weight[0].numpy(), minlength=len(angle))
    mean = float(envmap.mean_radiance(torch.from_numpy(environment)).mean())
    added = (key.strength * math.pi * mean) * share / angle
    return (environment + added.reshape(height, width, 1)).astype(np.float32)


def is_neutral(environment: np.ndarray) -> bool:
    """Whether a starting light [H, W, 3] is one colour times a `white_light`, but for a key light: its level comes from
    the photographs."""
    from scipy.stats import theilslopes

    light = np.asarray(environment, np.float64)
    sines = envmap.sines(len(light)).numpy()
    rows = np.median(light, axis=1)
    lines = [theilslopes(rows[:, c], sines) for c in range(3)]  # a key light near the pole takes whole rows
    even = np.stack([line.intercept + line.slope * sines for line in lines], axis=1)
    off = light - even[:, None]
    alike = np.ptp([line.slope / max(line.intercept, 1e-30) for line in lines]) <= 1e-4
    away = np.abs(off).max(axis=2) > 1e-5 * max(float(even.max()), 1e-30)
    share = (away * envmap.solid_angles(*away.shape)[:, None]).sum() / (4 * math.pi)
    return bool(alike and share <= SPOT and (off[away] > 0).all())
