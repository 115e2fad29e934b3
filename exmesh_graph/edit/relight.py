"""An asset under another light: itself, pictures of it, films."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.io.envmaps import shift_columns
from exmesh_graph.io.images import display
from exmesh_graph.types import Asset, Transport

Progress = Callable[[int, int], None]

BACKGROUND = 0.13
"""Display value behind the object."""


def relit(asset: Asset, radiance: np.ndarray | None = None, *, rotation: float = 0.0, exposure: float = 0.0) -> Asset:
    """`asset` with its environment exchanged for `radiance` [h, w, 3] (canonical lat-long; None: its own).

    rotation   [rad], counter-clockwise about +Y seen from above: what shone from +Z shines from +X at pi/2
    exposure   [stops]: radiance is multiplied by 2^exposure
    """
    light = asset.environment if radiance is None else radiance
    return replace(asset, environment=turned(light, rotation) * np.float32(2.0**exposure))


def turned(radiance: np.ndarray, rotation: float) -> np.ndarray:
    """A canonical lat-long map [h, w, C] turned by `rotation` [rad] about +Y, as `relit` says.

    u falls with longitude, so texels move left by w rotation / 2 pi; linear between columns: rows keep their sums.
    """
    columns = rotation / (2 * math.pi) * radiance.shape[1]
    return shift_columns(np.asarray(radiance, np.float32), round(columns, 6))


def turntable(
    asset: Asset,
    *,
    frames: int = 36,
    size: int = 384,
    elevation: float = 0.35,
    turn: Literal["camera", "light"] = "camera",
    transport: Transport | None = None,
    bounces: int = 8,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[np.ndarray]:
    """`frames` display images [size, size, 3] of one whole turn of the camera, or of the light at a still camera."""
    from exmesh_graph.stage2.render import render_transport

    transport = transport or render_transport(asset, bounces)
    settings: dict[str, Any] = {"transport": transport, "seed": seed}
    if turn == "camera":
        cameras = orbit(frames, size, size, elevation=elevation)
        return pictures(asset, *cameras, size, size, progress=progress, **settings)
    images = []
    camera = orbit(1, size, size, elevation=elevation)
    for k in range(frames):
        light = turned(asset.environment, 2 * np.pi * k / frames)
        images += pictures(asset, *camera, size, size, environment=light, **settings)
        if progress:
            progress(k + 1, frames)
    return images


def pictures(
    asset: Asset,
    intrinsics: np.ndarray,
    camera_to_world: np.ndarray,
    height: int,
    width: int,
    *,
    progress: Progress | None = None,
    **settings: Any,
) -> list[np.ndarray]:
    """Display images [H, W, 3] of the asset at the cameras, over a dark ground; `settings` go to `render_views`."""
    from exmesh_graph.stage2.render import render_views

    rendered = render_views(asset, intrinsics, camera_to_world, height, width, progress=progress, **settings)
    pairs = zip(rendered.images, rendered.alpha, strict=True)
    return [display(image, alpha) + BACKGROUND * (1 - alpha[..., None]) for image, alpha in pairs]


def write_film(path: Path, images: Sequence[np.ndarray], seconds: float = 4.0, quality: int = 80) -> None:
    """Write display images [H, W, 3] as a looping animated WebP, which browsers and viewers play."""
    from PIL import Image

    frames = [Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)) for image in images]
    duration = max(round(1000 * seconds / len(frames)), 1)
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=duration, loop=0, quality=quality, method=4)
