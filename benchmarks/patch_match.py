"""Depth from photographs alone: error and seconds of `prior.patch_match` against `prior.plane_sweep`, on a true mesh.

python -m benchmarks.patch_match SCENE ... [--downscale N] [--set NAME=VALUE ...] [--no-sweep] [--json FILE]

Each scene with its masks and, on a second line, without. Errors are of the depth along the camera's axis, in percent of
2, the range of normalised units; `complete`, `complete, 1 %` and `outside` in percent of the pixels that show the true
mesh. Seconds are processor seconds of one thread, in all and for a million pixels of a view, masked ones included.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.coarse_work import load_case
from benchmarks.register import choosing
from exmesh_graph.gpu.cores import cores
from exmesh_graph.priors.patch_match.estimate import patch_match
from exmesh_graph.priors.plane_sweep import plane_sweep
from exmesh_graph.priors.settings import PatchMatchSettings, SweepSettings
from exmesh_graph.raster import project, rasterize_projected
from exmesh_graph.types import DepthMaps, Views

HEAD = (
    f"{'':28s} {'s':>6s} {'s/Mpx':>6s} {'median':>7s} {'0.5 %':>6s} {'1 %':>6s} {'compl.':>6s} {'c., 1%':>6s} outside"
)


def main() -> None:
    options = arguments()
    torch.set_num_threads(1)
    settings = PatchMatchSettings.model_validate(dict(one.split("=", 1) for one in options.set))
    rows: list[dict[str, Any]] = []
    for scene in options.scenes:
        choosing(scene)
        case = load_case(scene, options.downscale, 0)
        if case.truth is None:
            sys.exit(f"{scene}: no true mesh to compare with")
        truth = true_depths(case.train, *case.truth)
        bare = replace(case.train, alpha=np.ones_like(case.train.alpha), has_masks=False)
        print(f"{scene.name}, {len(case.train)} views of {case.train.width} x {case.train.height}\n{HEAD}")
        for name, views in (("masks", case.train), ("no masks", bare)):
            methods: dict[str, Callable[[Views], DepthMaps]] = {
                "patch match": lambda v: patch_match(v, settings).depths,
                "plane sweep": lambda v: plane_sweep(v, SweepSettings()),
            }
            for method, make in methods.items():
                if method == "plane sweep" and options.no_sweep:
                    continue
                with cores(1):
                    start = time.process_time()
                    depth = make(views).depth
                    seconds = time.process_time() - start
                row = {"scene": scene.name, "method": f"{method}, {name}", **scored(depth, truth, seconds)}
                rows.append(row)
                print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with a true mesh")
    parser.add_argument("--downscale", type=int, default=1, help="reduce the pictures by this factor")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="settings of the patch match")
    parser.add_argument("--no-sweep", action="store_true", help="leave the plane sweep out")
    parser.add_argument("--json", type=Path, help="write the table here too")
    return parser.parse_args()


def true_depths(views: Views, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """float32 [N, H, W] along the camera's axis, 0 where the mesh is not seen."""
    points = torch.from_numpy(np.ascontiguousarray(vertices, np.float32))
    triangles = torch.from_numpy(np.ascontiguousarray(faces, np.int32))
    depths = []
    for intrinsics, pose in zip(views.intrinsics, views.world_to_camera, strict=True):
        placed = project(points, torch.from_numpy(intrinsics), torch.from_numpy(pose))
        depths.append(rasterize_projected(placed, triangles, views.height, views.width).depth.numpy())
    return np.stack(depths)


def scored(depth: np.ndarray, truth: np.ndarray, seconds: float) -> dict[str, float]:
    """Errors and shares in percent of `depth` [N, H, W] against `truth`; 0 is no depth in either."""
    shown = truth > 0
    both = shown & (depth > 0)
    error = 50 * np.abs(depth - truth)[both] if both.any() else np.array([np.inf])
    return {
        "seconds": seconds,
        "seconds_per_megapixel_view": seconds / (depth.size / 1e6),
        "median": float(np.median(error)),
        "within_half": 100 * float((error < 0.5).mean()),
        "within_one": 100 * float((error < 1).mean()),
        "complete": 100 * float(both.sum() / shown.sum()),
        "complete_within_one": 100 * float((error < 1).sum() / shown.sum()),
        "outside": 100 * float(((depth > 0) & ~shown).sum() / shown.sum()),
    }


def line(row: dict[str, Any]) -> str:
    figures = [row[name] for name in ("within_half", "within_one", "complete", "complete_within_one", "outside")]
    return (
        f"{row['method']:28s} {row['seconds']:6.1f} {row['seconds_per_megapixel_view']:6.2f} {row['median']:7.3f} "
        + " ".join(f"{figure:6.1f}" for figure in figures)
    )


if __name__ == "__main__":
    main()
