"""What a result costs: relighting speed by the paper's rule, and the size of a mesh as a PLY file.

Peak memory and seconds per stage are those the run recorded; `report.json` sums them (docs/report.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from exmesh_graph.errors import NumericsError
from exmesh_graph.evaluate.settings import SpeedParams
from exmesh_graph.types import Asset, Views


def measure_speed(asset: Asset, views: Views, p: SpeedParams, *, seed: int = 0) -> dict[str, Any]:
    """Frames per second of square pictures under a light the asset never had, by the paper's rule; the mesh's size.

    Tracing the light transport, which depends on the mesh alone, counts as loading. A frame here sets its light anew
    (`render_views` does it on every call), so the update is not shared out: the figure errs on the slow side.
    """
    from exmesh_graph.stage2.render import render_transport, render_views

    transport = render_transport(asset, p.bounces, p.directions)
    light = np.ascontiguousarray(np.roll(asset.environment, asset.environment.shape[1] // 3, axis=1))
    scale = np.diag([p.size / views.width, p.size / views.width, 1.0])

    def render(frame: int) -> None:
        i = frame % len(views)
        render_views(
            asset, (scale @ views.intrinsics[i])[None], views.camera_to_world[i][None], p.size, p.size,
            environment=light, transport=transport, supersampling=p.supersampling,
            specular_samples=p.specular_samples, seed=seed,
        )  # fmt: skip

    fps = relight_fps(lambda: None, render, p.frames)
    vertices, faces = len(asset.vertices), len(asset.faces)
    stored = ply_bytes(vertices, faces)
    return {
        "relight_fps": fps,
        "size": p.size,
        "timed_frames": p.frames - 1,
        "vertices": vertices,
        "faces": faces,
        "ply_bytes": stored,
        "headline": [
            {"label": f"Relighting at {p.size} x {p.size}", "value": fps, "unit": "frames/s", "better": "higher"},
            {"label": "PLY", "value": stored / 1e6, "unit": "MB", "better": "lower"},
        ],
    }


def relight_fps(
    update: Callable[[], None], render: Callable[[int], object], views: int, *, clock: Callable[[], float] | None = None
) -> float:
    """Frames per second of relighting `views` views under one light, as ExMesh++ counts it.

    update    sets the environment map; its time is shared by the timed frames
    render    renders view i and waits until the picture is there (on a GPU: synchronise)

    The first frame, with an update of its own, is a warm-up and left out; loading, reading and writing are outside.
    """
    if views < 2:
        raise NumericsError("relighting speed needs two views or more", expected="one warm-up frame and timed ones")
    clock = clock or time.perf_counter
    update()
    render(0)
    begun = clock()
    update()
    for view in range(1, views):
        render(view)
    return (views - 1) / max(clock() - begun, 1e-12)


def ply_bytes(vertices: int, faces: int) -> int:
    """Size of a mesh as binary PLY (`benchmarks.meshes.write_ply`): float32 positions, int32 triangles, nothing else.

    The paper's "unified PLY format" is not described; its 52 K vertices in 2.63 MB are 0.6 MB more than this form
    takes, as much as normals would.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return len(header) + 12 * vertices + 13 * faces
