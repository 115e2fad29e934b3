"""Are masks, cameras and scale understood? The world a loader makes, and visual hulls drawn back into their masks.

    python -m benchmarks.hulls                                              # the sample
    python -m benchmarks.hulls path/to/concave --middlebury path/to/temple_ring --idr path/to/dtu_scan24
    python -m benchmarks.hulls --quick

For every scene its up axis in the files' own axes and, where the true mesh is known, how far that reaches from the
origin, in the normalised world and back in the scene's units. Then, where there are masks, hulls with no and with one
wrong mask allowed: intersection over union of hull and mask at the pixels' centres, mean and least over the training
views, and processor seconds of the hull. Middlebury's pictures are halved, and tried with the pixel centres at +0.5 and
at 0.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from exmesh_graph.geometry.clean import taubin
from exmesh_graph.geometry.hull import SilhouetteField, visual_hull
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.idr import load_idr
from exmesh_graph.io.middlebury import load_middlebury
from exmesh_graph.io.settings import BlenderOptions, IdrOptions, MiddleburyOptions
from exmesh_graph.raster import rasterize
from exmesh_graph.types import Frame, SceneTruth, Views

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hulls", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path, nargs="*", default=[SAMPLE], help="in the NeRF-Synthetic layout")
    parser.add_argument("--middlebury", type=Path, nargs="*", default=[], help="folders in Middlebury's layout")
    parser.add_argument("--idr", type=Path, nargs="*", default=[], help="folders in IDR's layout")
    parser.add_argument("--grid", type=int, default=128, help="points along the hull's longest side")
    parser.add_argument("--quick", action="store_true", help="a coarse grid and pictures of a quarter of the size")
    parser.add_argument("--json", type=Path, help="write the rows here too")
    options = parser.parse_args()
    shrink = 4 if options.quick else 1
    grid = 48 if options.quick else options.grid
    rows: list[dict[str, Any]] = []
    for path in options.scenes:
        found = load_blender(path, BlenderOptions(downscale=shrink))
        rows += measure(path.name, found.train, found.frame, found.truth, grid)
    for path in options.middlebury:
        for offset in (0.5, 0.0):
            given = load_middlebury(path, MiddleburyOptions(downscale=2 * shrink, pixel_offset=offset))
            rows += measure(f"{path.name}, pixel centres at +{offset:g}", given.train, given.frame, None, grid)
    for path in options.idr:
        idr = load_idr(path, IdrOptions(downscale=shrink))
        rows += measure(path.name, idr.train, idr.frame, None, grid)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def measure(name: str, views: Views, frame: Frame, truth: SceneTruth | None, grid: int) -> list[dict[str, Any]]:
    """The scene's row, and one for each hull."""
    up = frame.dataset_from_scene[:3, :3] @ np.array([0.0, 1.0, 0.0])
    world: dict[str, Any] = {"scene": name, "views": len(views), "up": up.tolist()}
    told = f"{name}: {len(views)} views of {views.width} x {views.height}, up ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f})"
    if truth is not None and truth.mesh_vertices is not None:
        points = truth.mesh_vertices.astype(np.float64)
        own = points @ frame.scene_from_normalised[:3, :3].T + frame.scene_from_normalised[:3, 3]
        world["reach"] = [float(np.linalg.norm(p, axis=1).max()) for p in (points, own)]
        told += f", reaches {world['reach'][0]:.3f}, in its own units {world['reach'][1]:.4f}"
    print(told, flush=True)
    if (views.alpha > 0.5).all():
        return [world]
    field = SilhouetteField.from_masks(views.alpha, views.intrinsics, views.world_to_camera)
    rows = [world]
    for wrong_masks in (0, 1):
        field = SilhouetteField.from_masks(
            views.alpha, views.intrinsics, views.world_to_camera, wrong_masks=wrong_masks
        )
        began = time.process_time()
        vertices, faces = visual_hull(field, resolution=grid)
        seconds = time.process_time() - began
        shares = overlap(taubin(vertices, faces, 10), faces, views)
        row = {
            "scene": name,
            "wrong_masks": wrong_masks,
            "iou": shares.mean(),
            "least": shares.min(),
            "seconds": seconds,
        }
        rows.append(row)
        print(
            f"  wrong_masks {wrong_masks}: IoU {row['iou']:.3f}, least {row['least']:.3f}; {seconds:.1f} s", flush=True
        )
    return rows


def overlap(vertices: np.ndarray, faces: np.ndarray, views: Views) -> np.ndarray:
    """Intersection over union of the mesh's outline and the mask, at pixel centres, for every view."""
    points, triangles = torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(faces.astype(np.int32))
    shares = []
    for k, pose, alpha in zip(views.intrinsics, views.world_to_camera, views.alpha, strict=True):
        camera = torch.from_numpy(k), torch.from_numpy(pose)
        drawn = rasterize(points, triangles, *camera, views.height, views.width).face_id.numpy() >= 0
        mask = alpha >= 0.5
        shares.append((drawn & mask).sum() / max(int((drawn | mask).sum()), 1))
    return np.array(shares)


if __name__ == "__main__":
    main()
