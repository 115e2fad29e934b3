"""Coarse starts from views with faults: what `init.auto` makes of them, beside the hull alone, and what it says.

    python -m benchmarks.robust_coarse [SCENE]            # default: the sample at 128 x 128, 500 iterations
    python -m benchmarks.robust_coarse [SCENE] --quick    # 64 x 64, 100 iterations
    python -m benchmarks.robust_coarse [SCENE] --stereo   # stereo, as without `iterations`

Chamfer and the hull's in thousandths of the true mesh's radius; "there" is the share of the true surface that the mesh
comes within two hundredths of the radius of; seconds of processor time of `init.auto`. Faults: 8 views only; no masks,
before a patterned ground; an object whose texture is smoothed away, and one of one flat grey; one view blurred and
moved; points of which a tenth lie far outside; a view in which nothing is seen.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from exmesh_nodes import auto, init
from scipy.ndimage import gaussian_filter

from benchmarks.robust_stage1 import Listening, unmasked, without
from exmesh_graph.errors import DataError, ExmeshError
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.evaluate.metrics.mesh import bounding_radius, chamfer
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.types import Mesh, PointCloud, Views

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    options = arguments()
    torch.set_num_threads(1)
    scene = load_blender(options.scene, BlenderOptions(downscale=4 if options.quick else 2))
    truth = scene.truth.mesh_vertices, scene.truth.mesh_faces
    radius = bounding_radius(truth[0])
    iterations = 0 if options.stereo else 100 if options.quick else 500
    rows: list[dict[str, Any]] = []
    print(f"{'fault':<28}{'start':>10}{'faces':>7}{'Chamfer':>9}{'there':>7}{'hull':>8}{'s':>7}   said")
    for name, (views, points) in faults(scene.train, truth).items():
        told = Listening()
        start = time.process_time()
        row: dict[str, Any] = {"fault": name}
        made = attempted(lambda v=views, p=points, t=told: auto.auto(
            t, v, p, p=auto.AutoParams(iterations=iterations, device="cpu")), row)  # fmt: skip
        row["seconds"] = time.process_time() - start
        if made is not None:
            chosen = {one["name"]: one["value"] for one in made.decisions.values["decisions"]}
            row["start"] = chosen.get("surface", chosen["start"])
            row |= {"faces": len(made.mesh.faces), **errors(made.mesh, truth, radius)}
        row["warnings"] = list(dict.fromkeys(told.told))
        bare = attempted(lambda v=views: cleaned_hull(v), {})
        row["hull"] = None if bare is None else errors(bare, truth, radius)["chamfer"]
        rows.append(row)
        print(_line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?", default=SAMPLE, help="NeRF-Synthetic layout with a true mesh")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--stereo", action="store_true", help="stereo in place of Gaussians")
    parser.add_argument("--json", type=Path, help="write the table here too")
    return parser.parse_args()


def faults(views: Views, truth: tuple[np.ndarray, np.ndarray]) -> dict[str, tuple[Views, PointCloud | None]]:
    every = range(len(views))
    step = len(views) // 8
    flat = views.alpha[..., None] * np.float32([0.3, 0.3, 0.3])
    grey = np.repeat(views.images.mean(-1, keepdims=True), 3, -1)
    smooth = np.stack([gaussian_filter(image, (6, 6, 0)) for image in grey]) * views.alpha[..., None]
    moved = views.images.copy()
    moved[5] = np.roll(gaussian_filter(moved[5], (4, 4, 0)), 6, axis=1)
    places = sample_surface(*truth, 3000, seed=0)[0].astype(np.float32)
    places[::10] *= 1000
    empty = views.images.copy(), views.alpha.copy()
    empty[0][7], empty[1][7] = 0, 0
    return {
        "clean": (views, None),
        "8 views": (without(views, [i for i in every if i % step or i >= 8 * step]), None),
        "no masks": (unmasked(views, list(every)), None),
        "no masks, points": (unmasked(views, list(every)), PointCloud(places, np.full_like(places, 0.5))),
        "texture smoothed away": (replace(views, images=smooth.astype(np.float32)), None),
        "one flat grey": (replace(views, images=flat.astype(np.float32)), None),
        "one view blurred and moved": (replace(views, images=moved), None),
        "a tenth of points far outside": (views, PointCloud(places, np.full_like(places, 0.5))),
        "a view without object": (replace(views, images=empty[0], alpha=empty[1]), None),
    }


def attempted(make: Callable[[], Any], row: dict[str, Any]) -> Any:
    """The result, or None with the error's first line in the row."""
    try:
        return make()
    except ExmeshError as error:
        row["error"] = str(error).splitlines()[0]
        return None


def cleaned_hull(views: Views) -> Mesh:
    if not views.masked.all():
        raise DataError("a hull needs a mask for every view")
    raw = init.visual_hull(Listening(), views, p=init.HullSettings()).mesh
    return init.clean(Listening(), raw, p=init.CleanSettings()).mesh


def errors(mesh: Mesh, truth: tuple[np.ndarray, np.ndarray], radius: float) -> dict[str, float]:
    there = distance_to_mesh(sample_surface(*truth, 20000, seed=1)[0], mesh.vertices, mesh.faces) < 0.02 * radius
    return {"chamfer": chamfer(mesh.vertices, mesh.faces, *truth).scaled(1000 / radius)["chamfer"],
            "there": float(np.mean(there))}  # fmt: skip


def _line(row: dict[str, Any]) -> str:
    hull = "-" if row["hull"] is None else f"{row['hull']:.2f}"
    said = "; ".join(row["warnings"]) or "-"
    if "error" in row:
        return f"{row['fault']:<28}{'':10}{'':7}{'':9}{'':7}{hull:>8}{row['seconds']:7.1f}   error: {row['error']}"
    return (
        f"{row['fault']:<28}{row['start']:>10}{row['faces']:7d}{row['chamfer']:9.2f}{row['there']:7.1%}{hull:>8}"
        f"{row['seconds']:7.1f}   {said}"
    )


if __name__ == "__main__":
    main()
