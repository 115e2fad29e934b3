"""The galleries of the nodes that use an asset: relit, edited, seen in Blender."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exmesh_graph.export.blender import BlenderSettings, camera_names, render_in_blender
from exmesh_graph.gallery.models import add_model
from exmesh_graph.gallery.pictures import GalleryWriter, environment_panels, shrink
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.io.images import display
from exmesh_graph.types import Asset, Gallery

GROUND = 0.13
"""Display value behind the objects where the light is not shown."""


def light_gallery(root: Path, asset: Asset, images: Sequence[np.ndarray]) -> Gallery:
    """An asset's light and display images [H, W, 3] under it."""
    writer = GalleryWriter(root)
    for k, image in enumerate(images):
        writer.add(f"picture_{k:02d}", f"Relit, picture {k + 1}", "The asset under this light.", [image])
    writer.add("light", "Light", "Lat-long, up is up, the centre looks along +Z.",
               environment_panels([asset.environment]))  # fmt: skip
    add_model(writer, asset, "Relit")
    return writer.finish()


def edit_gallery(root: Path, before: Asset, after: Asset, weight: np.ndarray, channel: str) -> Gallery:
    """A map before and after an edit, and where it was changed."""
    writer = GalleryWriter(root)
    maps = [getattr(asset, channel) for asset in (before, after)]
    panels = [shrink(np.zeros_like(weight) if image is None else image) for image in maps]
    if channel == "base_color":
        panels = [linear_to_srgb(panel) for panel in panels]
    words = channel.replace("_", " ")
    writer.add("edit", f"Edited {words}", "Before, after, weight of the edit.", [*panels, shrink(weight)])
    add_model(writer, after, f"Edited {words}")
    return writer.finish()


def blender_gallery(
    root: Path,
    usd: Path,
    python: str,
    cameras: Sequence[str] = (),
    pictures: int = 3,
    *,
    samples: int = 64,
    scale: float = 1.0,
    background: bool = False,
    threads: int = 1,
) -> Gallery:
    """Render `cameras`, or `pictures` of the file's cameras spread over all, and write them as PNG files."""
    known = camera_names(usd)
    count = min(pictures, len(known))
    chosen = list(cameras) or [known[len(known) * (2 * k + 1) // (2 * count)] for k in range(count)]
    settings = BlenderSettings(Path(python), samples=samples, threads=threads, transparent=not background)
    writer = GalleryWriter(root)
    for view, picture in render_in_blender(usd, settings, cameras=chosen, scale=scale).items():
        alpha = picture[..., 3]
        shown = display(picture[..., :3], alpha) + GROUND * (1 - alpha[..., None])
        writer.add(view, f"Blender, {view}", f"Cycles, {samples} samples, {usd.name}", [shown])
    return writer.finish()
