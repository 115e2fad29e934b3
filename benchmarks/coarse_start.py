"""Coarse meshes of a scene: seconds and error of every start, in one run.

python -m benchmarks.coarse_start [SCENE] [--pgsr N ...] [--sweep] [--stereo] [--clean] [--quick] [--json FILE]
                                  [--picture PNG]

SCENE is a folder in the NeRF-Synthetic, IDR or Middlebury layout (default: the sample in the repository). Chamfer,
where there is a true mesh, is in thousandths of its radius. Rephotography, in dB: the training photographs warped over
the mesh against held-out ones (evaluate.metrics.rephotography), over the object's mask, or without masks over the
region that the photographs give (evaluate.region). Seconds are of this process on one thread, each start from the
photographs on; peak memory is that of the process so far.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.coarse_work import Surface, fitted, fused, hull, load_case, monocular, picture, solid, stereo
from benchmarks.register import choosing
from exmesh_graph.evaluate.metrics.mesh import bounding_radius, chamfer
from exmesh_graph.evaluate.metrics.rephotography import Rephotographs, prediction_psnr, rephotograph
from exmesh_graph.evaluate.region import find_region
from exmesh_graph.geometry.clean import clean_mesh
from exmesh_graph.geometry.settings import CleanSettings
from exmesh_graph.io.images import encode_rgba, write_image
from exmesh_graph.types import DepthMaps

SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    options = arguments()
    choosing(options.scene)
    torch.set_num_threads(1)
    case = load_case(options.scene, options.downscale, options.views)
    radius = bounding_radius(case.truth[0]) if case.truth else 1.0
    rows: list[dict[str, Any]] = []
    foretold: list[Rephotographs] = []
    shown: list[Surface] = []

    def measure(name: str, make: Callable[[], Surface], before: float = 0.0) -> Surface:
        start = time.process_time()
        vertices, faces = make()
        row = {"start": name, "faces": len(faces), "seconds": before + time.process_time() - start}
        if case.truth:
            row |= chamfer(vertices, faces, *case.truth).scaled(1000 / radius)
        edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
        row["edge_spread"] = float(edges.std() / edges.mean())
        row["peak_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        foretold.append(rephotograph(vertices, faces, case.train, case.held_out))
        rows.append(row)
        print(_line(row), flush=True)
        return vertices, faces

    def depths(make: Callable[[], DepthMaps]) -> tuple[DepthMaps, float]:
        start = time.process_time()
        return make(), time.process_time() - start

    if case.truth:
        shown.append(measure("truth", lambda: case.truth))
    if case.field is not None:
        for resolution in (96, 128):
            start = measure(f"hull {resolution}", lambda n=resolution: hull(case, n))
        shown.append(start)
        for budget in (2000, 5000, 20000) if options.clean else ():
            for method in ("builtin", "pymeshlab", "open3d"):
                measure(f"{method} {budget}",
                        lambda b=budget, m=method: clean_mesh(*start, CleanSettings(faces=b, method=m)))  # fmt: skip
    sources: list[tuple[str, Callable[[], DepthMaps]]] = []
    if options.sweep or case.mono is not None:
        sources.append(("plane sweep", case.sweep))
    if case.mono is not None:
        sources += [("monocular", lambda: monocular(case, 0.0)), ("monocular, bent", lambda: monocular(case, 0.03))]
    if options.stereo:
        sources.append(("patch match", lambda: stereo(case)))
    sources += [(f"pgsr {n}", lambda n=n: fitted(case, n)) for n in options.pgsr]
    for name, make in sources:
        kept, seconds = depths(make)
        if case.field is not None:
            told = {"clear": 2.0, "blur": 1.0} if name == "patch match" else {}
            shown.append(measure(f"{name}, solid", lambda k=kept, t=told: solid(case, k, **t), seconds))
            for clear in options.clear:
                measure(f"{name}, clear {clear:g}", lambda k=kept, c=clear: solid(case, k, c), seconds)
        whole = measure(f"{name}, fused", lambda k=kept: fused(case, k), seconds)
        if case.field is None:
            shown.append(whole)
    _score(rows, foretold, case.held_out, case.train)
    if options.json:
        options.json.write_text(json.dumps({"scene": options.scene.name, "rows": rows}, indent=1) + "\n")
    if options.picture:
        write_image(options.picture, encode_rgba(*picture(case.train, shown, options.shown)))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?", default=SAMPLE)
    parser.add_argument("--pgsr", type=int, nargs="*", default=[500, 1500], help="lengths of the fits, in iterations")
    parser.add_argument(
        "--clear", type=float, nargs="*", default=[], help="solids that carve from so many voxels on, too"
    )
    parser.add_argument("--clean", action="store_true", help="clean-up methods and face budgets too")
    parser.add_argument("--sweep", action="store_true", help="depth maps by plane sweep too (always with mono_depth/)")
    parser.add_argument(
        "--stereo",
        action="store_true",
        help="depth maps by PatchMatch too; its solid begins 2 voxels below the hull, and is blurred",
    )
    parser.add_argument("--downscale", type=int, default=1, help="reduce the pictures by this factor")
    parser.add_argument("--views", type=int, default=0, help="at most so many training views; 0: all")
    parser.add_argument("--quick", action="store_true", help="reduced pictures and one fit of 100 iterations")
    parser.add_argument("--json", type=Path, help="write the table here too")
    parser.add_argument("--picture", type=Path, help="the photograph, then normals of the truth and each start")
    parser.add_argument("--shown", type=int, nargs="+", default=[0, 9, 20], help="training views in the picture")
    options = parser.parse_args()
    if options.quick:
        options.downscale, options.pgsr = 4 * options.downscale, [100]
    return options


def _line(row: dict[str, Any]) -> str:
    error = f"chamfer {row['chamfer']:6.2f}  p95 {row['p95']:6.2f}  max {row['max']:6.1f}" if "chamfer" in row else ""
    return (
        f"{row['start']:24s} {row['faces']:7d} faces {row['seconds']:7.1f} s  {error}"
        f"  edge spread {row['edge_spread']:.2f}  peak {row['peak_mib']:.0f} MiB"
    )


def _score(rows: list[dict[str, Any]], foretold: list[Rephotographs], held_out: Any, train: Any) -> None:
    """Rephotography of all starts over the same pixels, which come from the data."""
    regions = held_out.alpha >= 0.5 if held_out.has_masks else find_region(held_out, train).inside
    print(f"\nrephotography over {regions.mean():.1%} of the held-out pixels")
    for row, made in zip(rows, foretold, strict=True):
        row["rephotography"] = float(prediction_psnr(made, held_out, regions).mean())
        row["shown"] = float(made.seen[regions].mean())
        print(f"{row['start']:24s} {row['rephotography']:6.2f} dB   shows {row['shown']:.1%}")


if __name__ == "__main__":
    main()
