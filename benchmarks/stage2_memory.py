"""Peak memory of a Stage II fit: predicted in advance, and measured.

    python -m benchmarks.stage2_memory            # 100 views of 800 x 800, 2048 maps; some minutes
    python -m benchmarks.stage2_memory --quick    # 20 views of 400 x 400, 1024 maps

A sphere on 57 % of each picture, seen by cameras on a ring, painted by its position; one fit of a few steps (with a
correction and D-SSIM) in a process of its own for each budget of the views' buffers. Columns: the budget, the views
that stay in memory, predicted and measured peak of the whole process, seconds of start and of a step, and a hash of
the result, which must not depend on the budget.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.stability import stage2_scenes as scenes
from exmesh_graph.gpu.torch_setup import tensor_of
from exmesh_graph.raster import rasterize
from exmesh_graph.resources import memory_in_use, peak_memory, reset_peak_memory
from exmesh_graph.shading.transport import trace_transport, with_bounces
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.memory import plan_memory
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.stage2.surface import CarrierGeometry
from exmesh_graph.types import Carrier, Views


def main() -> int:
    options = arguments()
    if options.child is not None:
        print(json.dumps(child(options)))
        return 0
    rows = []
    for budget in options.memory_gib:
        command = [sys.executable, "-m", "benchmarks.stage2_memory", "--child", str(budget)]
        for key in ("views", "size", "texture", "points", "iterations", "threads"):
            command += [f"--{key}", str(getattr(options, key))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.stderr)
        row = json.loads(done.stdout.splitlines()[-1])
        rows.append(row)
        memory = f"predicted {row['predicted']:.2f} GiB  measured {row['measured']:.2f} GiB"
        times = f"start {row['start']:.1f} s  step {row['step']:.2f} s  {row['hash'][:12]}"
        print(f"budget {budget:6.2f} GiB  {row['held']:4d} of {options.views} views held  {memory}  {times}")
        print("   ", row["plan"], flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    same = len({row["hash"] for row in rows}) == 1
    print("same bytes whatever the budget" if same else "THE BUDGET CHANGED THE RESULT")
    return 0 if same else 1


def child(options: argparse.Namespace) -> dict[str, object]:
    torch.set_num_threads(options.threads)
    carrier = replace(scenes.sphere(), texture=np.full((options.texture, options.texture, 3), 0.5, np.float32))
    views = pictures(carrier, options.views, options.size)
    subdivision = next(n for n in range(1, 17) if len(carrier.faces) / 2 * n * n >= options.points)
    light = with_bounces(trace_transport(carrier.vertices, carrier.faces, 128, subdivision), 1)
    settings = DecompositionSettings(
        iterations=options.iterations,
        corrections=1,
        environment_height=128,
        memory_gib=options.child,
    )
    plan = plan_memory(carrier, views, light, settings, memory_in_use())
    reset_peak_memory()
    began = time.perf_counter()
    times: list[float] = []
    asset, _ = fit(carrier, views, light, settings, checkpoint=lambda *_: times.append(time.perf_counter()))
    found = hashlib.sha256(b"".join(m.tobytes() for m in (asset.base_color, asset.roughness, asset.environment)))
    return {
        "budget": options.child,
        "held": plan.held,
        "predicted": plan.total / 2**30,
        "measured": peak_memory() / 2**30,
        "plan": str(plan),
        "start": times[0] - began,
        "step": float(np.median(np.diff(times))),
        "hash": found.hexdigest(),
    }


def pictures(carrier: Carrier, count: int, size: int) -> Views:
    """Pictures of the carrier painted by position; their light is not physical, and no score is taken."""
    geometry = CarrierGeometry(carrier)
    intrinsics, poses = scenes.cameras(count, size)
    images = np.zeros((count, size, size, 3), np.float32)
    alpha = np.zeros((count, size, size), np.float32)
    for k in range(count):
        seen = rasterize(
            geometry.vertices,
            geometry.faces.int(),
            tensor_of(intrinsics[k]),
            torch.from_numpy(np.linalg.inv(poses[k])),
            size,
            size,
        )
        inside = seen.face_id >= 0
        corners = geometry.vertices[geometry.faces[seen.face_id[inside].long()]]
        images[k][inside.numpy()] = 0.3 + 0.4 * (corners * seen.bary[inside][..., None]).sum(1).numpy()
        alpha[k] = inside.numpy()
    names = tuple(f"v{k:03d}" for k in range(count))
    return Views(names, images, alpha, intrinsics, poses, "train", clipped=True)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stage2_memory",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--views", type=int, default=100)
    parser.add_argument("--size", type=int, default=800)
    parser.add_argument("--texture", type=int, default=2048)
    parser.add_argument("--points", type=int, default=50_000, help="of the light transport, about")
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--memory-gib", type=float, nargs="+", default=[4.0, 0.0])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--child", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.quick:
        options.views, options.size, options.texture, options.points = 20, 400, 1024, 12_000
        options.memory_gib = [4.0, 0.2, 0.0]
    return options


if __name__ == "__main__":
    sys.exit(main())
