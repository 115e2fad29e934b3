"""The gallery of an asset as Blender sees it: apart from the others, whose nodes need not know its version."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exmesh_graph.export.blender import BlenderSettings, camera_names, render_in_blender
from exmesh_graph.gallery.pictures import GalleryWriter
from exmesh_graph.io.images import display
from exmesh_graph.types import Gallery

GROUND = 0.13
"""Display value behind the objects where the light is not shown."""


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
