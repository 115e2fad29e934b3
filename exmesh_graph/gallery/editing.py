"""The galleries of the nodes that use an asset: relit, edited."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exmesh_graph.gallery.models import add_model
from exmesh_graph.gallery.pictures import GalleryWriter, environment_panels, shrink
from exmesh_graph.io.color import linear_to_srgb
from exmesh_graph.types import Asset, Gallery


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
