"""Relighting speed of an asset, and the size of its mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from exmesh_graph.evaluate.metrics.efficiency import ply_bytes, relight_fps
from exmesh_graph.evaluate.renders import Quality
from exmesh_graph.types import Asset, Views


def measure_speed(asset: Asset, views: Views, size: int, frames: int, quality: Quality) -> dict[str, Any]:
    """Frames per second of `frames` pictures of `size` x `size` under a light the asset never had, by the paper's rule.

    Tracing the light transport, which depends on the mesh alone, counts as loading. A frame here sets its light anew
    (`render_views` does it on every call), so the update is not shared out: the figure errs on the slow side.
    """
    from exmesh_graph.stage2.render import render_transport, render_views

    transport = render_transport(asset, quality.bounces, quality.directions)
    light = np.ascontiguousarray(np.roll(asset.environment, asset.environment.shape[1] // 3, axis=1))
    scale = np.diag([size / views.width, size / views.width, 1.0])

    def render(frame: int) -> None:
        i = frame % len(views)
        render_views(
            asset, (scale @ views.intrinsics[i])[None], views.camera_to_world[i][None], size, size, environment=light,
            transport=transport, supersampling=quality.supersampling, specular_samples=quality.specular_samples,
            seed=quality.seed,
        )  # fmt: skip

    fps = relight_fps(lambda: None, render, frames)
    vertices, faces = len(asset.vertices), len(asset.faces)
    stored = ply_bytes(vertices, faces)
    return {
        "relight_fps": fps,
        "size": size,
        "timed_frames": frames - 1,
        "vertices": vertices,
        "faces": faces,
        "ply_bytes": stored,
        "headline": [
            {"label": f"Relighting at {size} x {size}", "value": fps, "unit": "frames/s", "better": "higher"},
            {"label": "PLY", "value": stored / 1e6, "unit": "MB", "better": "lower"},
        ],
    }
