"""What do coarser levels of detail cost? Faces, megabytes and held-out PSNR of an exported asset of the sample.

    python benchmarks/lod.py runs/latest/asset.usdz [--views 8] [--quick] [--json FILE]

Each row decimates the asset on its own atlas, bakes the fine normals, reduces the maps, exports glTF for its size, and
renders the sample's test views.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from exmesh_graph.evaluate.metrics.image import psnr
from exmesh_graph.export.gltf import write_gltf
from exmesh_graph.export.lod import footprint_size, reduced
from exmesh_graph.export.usd import read_usd
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.images import display
from exmesh_graph.stage2.render import render_views

SCENE = Path(__file__).resolve().parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("usd", type=Path, help="an asset exported from the sample, with its light")
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--quick", action="store_true", help="one view, one level")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    asset, scene = read_usd(options.usd).asset(), load_blender(SCENE)
    views, size = scene.test, asset.base_color.shape[0]
    chosen = list(range(1 if options.quick else min(options.views, len(views))))
    print(f"a texel is no larger than a pixel of the training views at maps of {footprint_size(asset, scene.train)}")
    rows = []
    for share, maps in [(1, size), (0.2, size // 2)] if options.quick else levels(size):
        began = time.process_time()
        level = asset if (share, maps) == (1, size) else reduced(asset, round(share * len(asset.faces)), maps)
        seconds = time.process_time() - began
        row = {"faces": len(level.faces), "maps": maps, "seconds": seconds}
        for name, shown in (("psnr", level), ("psnr_without_baked_normals", replace(level, normal=asset.normal))):
            if name == "psnr" or (share < 1 and maps == size):
                row[name] = score(shown, views, chosen)
        with tempfile.TemporaryDirectory(prefix="exmesh-lod-") as folder:
            row["megabytes"] = write_gltf(Path(folder) / "out", level)["bytes"] / 1e6
        rows.append(row)
        bare = row.get("psnr_without_baked_normals")
        print(
            f"{row['faces']:8d} faces  maps {maps:5d}  {row['megabytes']:6.2f} MB  {row['psnr']:6.2f} dB"
            + (f"  (without baked normals {bare:.2f})" if bare else "") + f"  {seconds:.1f} s",
            flush=True,
        )  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def levels(size: int) -> list[tuple[float, int]]:
    """(share of the faces, side of the maps)."""
    return [(1, size), (0.5, size), (0.25, size), (0.15, size), (1, size // 2), (0.5, size // 2), (0.2, size // 2)]


def score(asset, views, chosen: list[int]) -> float:
    """Mean PSNR over whole pictures, over black."""
    pose = (views.intrinsics[chosen], views.camera_to_world[chosen])
    rendered = render_views(asset, *pose, views.height, views.width)
    pairs = zip(rendered.images, rendered.alpha, chosen, strict=True)
    return float(
        np.mean([psnr(display(i, a), display(views.images[k], views.alpha[k])) for i, a, k in pairs])
    )  # fmt: skip


if __name__ == "__main__":
    main()
