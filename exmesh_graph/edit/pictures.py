"""Pictures and films of an asset under a light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from exmesh_graph.edit.cameras import orbit
from exmesh_graph.edit.relight import turned
from exmesh_graph.io.images import display
from exmesh_graph.types import Asset, Transport

Progress = Callable[[int, int], None]

BACKGROUND = 0.13
"""Display value behind the object."""


def turntable(
    asset: Asset,
    *,
    frames: int = 36,
    size: int = 384,
    elevation: float = 0.35,
    turn: Literal["camera", "light"] = "camera",
    transport: Transport | None = None,
    bounces: int = 2,
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
