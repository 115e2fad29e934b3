"""What the renderer leaves at best: a scene's true mesh, maps and light, scored like a reconstruction.

    python -m benchmarks.ceiling                 # the sample: eight test views, the training light and two unseen ones
    python -m benchmarks.ceiling --quick         # two of the views
    python -m benchmarks.ceiling FOLDER/blocks   # another rendered scene
    python -m benchmarks.ceiling --supersampling 4 --specular-samples 4
    python -m benchmarks.ceiling --binned-suns   # small suns shine from the nearest of the transport's directions

Prints the figures of `evaluate.asset` with their floors, the Chamfer distance of the mesh to itself, and processor
seconds. What a reconstruction scores below these figures is its own error, not the renderer's.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import torch

from benchmarks.blender import SCENE, true_asset
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.evaluate.metrics.mesh import bounding_radius, chamfer
from exmesh_graph.evaluate.settings import Quality
from exmesh_graph.io.blender import load_blender
from exmesh_graph.shading.suns import find_suns
from exmesh_graph.stage2 import render


def main() -> None:
    """Score and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ceiling", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", type=Path, nargs="?", default=SCENE)
    parser.add_argument("--views", type=int, default=0, help="score this many test views; 0: all")
    parser.add_argument("--quick", action="store_true", help="two views")
    parser.add_argument("--supersampling", type=int, default=2, help="samples per pixel side")
    parser.add_argument("--specular-samples", type=int, default=12, help="GGX rays per sample of a pixel")
    parser.add_argument("--bounces", type=int, default=8)
    parser.add_argument("--binned-suns", action="store_true", help="no rays of their own for small suns")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scene = load_blender(options.scene)
    assert scene.truth is not None
    asset = true_asset(scene.truth, options.scene)
    if options.binned_suns:
        render.find_suns = lambda sky, count: find_suns(torch.ones_like(sky), count)
    quality = Quality(
        supersampling=options.supersampling, specular_samples=options.specular_samples, bounces=options.bounces
    )
    begun = time.process_time()
    views = 2 if options.quick else options.views
    scores = score_asset(asset, scene.test, scene.truth, scene.train, max_views=views, quality=quality)
    seconds = time.process_time() - begun
    rows = {entry["label"]: {name: entry.get(name) for name in ("value", "unit", "floor")}
            for entry in scores.values["headline"]}  # fmt: skip
    truth = scene.truth.mesh_vertices, scene.truth.mesh_faces
    own = chamfer(asset.vertices, asset.faces, *truth).chamfer / bounding_radius(scene.truth.mesh_vertices)
    rows["Chamfer"] = {"value": 1000 * own, "unit": "‰ of radius", "floor": None}
    for label, row in rows.items():
        floor = "" if row["floor"] is None else f"   a gray object {row['floor']:.4g}"
        print(f"{label:<36}{row['value']:>12.4g} {row['unit']}{floor}")
    print(f"{len(scores.views)} views, {seconds:.1f} processor seconds")
    if options.json:
        options.json.write_text(json.dumps({"rows": rows, "seconds": seconds}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
