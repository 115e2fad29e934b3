"""Occlusion rays: rate over threads beside embreex alone, agreement of the backends, rays that escape a closed box.

    python benchmarks/rays.py [--scene graphs/samples/spot] [--rays 2000000] [--box 10000000] [--json rays.json]
    python benchmarks/rays.py --quick

The rate wanted is 90 % of embreex's own: `cores` times what one thread of it does with rays already in its format.
All rates are wall-clock, the best of several turns that alternate between the rows of the table; `embreex, all cores`
is what the machine gives when that thread is simply repeated (less than the sum where cores share anything). The CPU
times per ray tell the same on a machine that is busy with other work.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch

from exmesh_graph.geometry.adjacency import face_normals
from exmesh_graph.io.blender import load_blender
from exmesh_graph.rays import MISS, make_ray_tracer, offset_origins
from exmesh_graph.rays.embree import EmbreeTracer
from exmesh_graph.rays.warp_bvh import WarpTracer

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
CUBE_FACES = np.array([f for a, b, c, d in _SIDES for f in ((a, b, c), (a, c, d))], np.int32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=Path("graphs/samples/spot"))
    parser.add_argument("--rays", type=int, default=2_000_000, help="occlusion rays per timed call")
    parser.add_argument("--box", type=int, default=10_000_000, help="rays from inside the closed box")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="a fifth of the rays, 200 000 in the box")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.rays, options.box, options.repeats = options.rays // 5, 200_000, 3
    truth = load_blender(options.scene).truth
    vertices, faces = np.asarray(truth.mesh_vertices, np.float64), np.asarray(truth.mesh_faces, np.int32)
    found = {
        "rate": rates(vertices, faces, options.rays, options.repeats),
        "agreement": agreement(vertices, faces, min(options.rays, 1_000_000)),
        "escapes": escapes(options.box),
    }
    for title, table in found.items():
        print(f"\n{title}")
        for name, value in table.items():
            print(f"  {name:52s}{value:>16.6g}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def rates(vertices: np.ndarray, faces: np.ndarray, count: int, repeats: int) -> dict[str, float]:
    """Millions of occlusion rays per second, from random points of the surface over the hemisphere above them."""
    cores = len(os.sched_getaffinity(0))
    origins, directions = surface_rays(vertices, faces, count)
    one, many = (EmbreeTracer(vertices, faces, threads) for threads in (1, cores))
    # embreex as it is: rays in its own format, its call and nothing else
    scene = one._scene
    o, d, far, _ = one._prepare(origins, directions, np.inf)
    parts = [slice(start, start + (1 << 16)) for start in range(0, count, 1 << 16)]

    def alone(part: slice) -> None:
        scene.run(o[part], d[part], dists=far[part], query="OCCLUDED")

    def repeated() -> None:
        with ThreadPoolExecutor(cores) as pool:
            list(pool.map(alone, parts))

    work: dict[str, Callable[[], object]] = {
        "embreex, 1 thread": lambda: [alone(part) for part in parts],
        "embreex, all cores": repeated,
        "ours, 1 thread": lambda: one.any_hit(origins, directions),
        "ours, all cores": lambda: many.any_hit(origins, directions),
        "ours, all cores, nearest hit": lambda: many.closest_hit(origins, directions),
    }
    if torch.cuda.is_available():
        cuda = WarpTracer(vertices, faces, "cuda")
        on_device = [torch.from_numpy(x).cuda() for x in (origins, directions)]
        work["warp on CUDA"] = lambda: (cuda.any_hit_tensors(*on_device), torch.cuda.synchronize())
    else:
        few = slice(0, count // 10)
        serial = WarpTracer(vertices, faces, "cpu")
        serial.any_hit(origins[:10], directions[:10])
        work["warp on CPU, serial (parity only)"] = lambda: serial.any_hit(origins[few], directions[few])
    best = dict.fromkeys(work, 0.0)
    busy = dict.fromkeys(work, np.inf)
    for _ in range(repeats):
        for name, run in work.items():
            began, work_began = time.perf_counter(), time.process_time()
            run()
            rays = count // 10 if "parity" in name else count
            best[name] = max(best[name], rays / (time.perf_counter() - began) / 1e6)
            busy[name] = min(busy[name], time.process_time() - work_began)
    total = cores * best["embreex, 1 thread"]
    return best | {
        "cores": cores,
        "ours over the sum of embreex's threads (wanted 0.9)": best["ours, all cores"] / total,
        "CPU time per ray, embreex's over ours, 1 thread": busy["embreex, 1 thread"] / busy["ours, 1 thread"],
        "CPU time per ray, embreex's over ours, all cores": busy["embreex, all cores"] / busy["ours, all cores"],
        "ours over embreex on all cores": best["ours, all cores"] / best["embreex, all cores"],
    }


def agreement(vertices: np.ndarray, faces: np.ndarray, count: int) -> dict[str, float]:
    """Shares of rays on which Warp and embree say the same (wanted: above 0.9999)."""
    origins, directions = surface_rays(vertices, faces, count, seed=1)
    embree, warp = make_ray_tracer(vertices, faces), WarpTracer(vertices, faces, _warp_device())
    nearest = [tracer.closest_hit(origins, directions) for tracer in (embree, warp)]
    blocked = [tracer.any_hit(origins, directions) for tracer in (embree, warp)]
    return {
        "any hit, warp as embree": float((blocked[0] == blocked[1]).mean()),
        "nearest face, warp as embree": float((nearest[0].face == nearest[1].face).mean()),
        "any hit as nearest hit, embree": float((blocked[0] == (nearest[0].face != MISS)).mean()),
        "any hit as nearest hit, warp": float((blocked[1] == (nearest[1].face != MISS)).mean()),
        "blocked": float(blocked[0].mean()),
    }


def escapes(count: int) -> dict[str, float]:
    """Rays from inside a closed box that meet nothing, half of them aimed at its edges, vertices and diagonals."""
    tracers = {"embree": make_ray_tracer(CUBE, CUBE_FACES), "warp": WarpTracer(CUBE, CUBE_FACES, _warp_device())}
    lost = dict.fromkeys(tracers, 0.0)
    chunk = 1_000_000
    for number, start in enumerate(range(0, count, chunk)):
        origins, directions = box_rays(min(chunk, count - start), number)
        for name, tracer in tracers.items():
            lost[name] += float((~tracer.any_hit(origins, directions)).sum())
    return {f"{name}, of {count} rays": value for name, value in lost.items()}


def box_rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from random places inside CUBE: one half anywhere, one half at points of its edges, vertices, diagonals."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-0.999, 0.999, (count, 3))
    origins[: count // 8] = 0
    targets = rng.normal(size=(count, 3)) * 10
    aimed = slice(0, count // 2)
    a, b = CUBE[rng.integers(0, 8, count // 2)], CUBE[rng.integers(0, 8, count // 2)]
    targets[aimed] = a + (b - a) * rng.integers(0, 65, (count // 2, 1)) / 64
    directions = targets - origins
    directions[np.abs(directions).max(axis=1) < 1e-9] = 1.0
    return origins, directions


def surface_rays(vertices: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Lifted random points of the surface (by area) and unit directions of their upper hemispheres, float32."""
    rng = np.random.default_rng(seed)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    points = (corners[face] * rng.dirichlet([1, 1, 1], count)[..., None]).sum(axis=1)
    normal = face_normals(vertices, faces)[face]
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions *= np.sign((directions * normal).sum(axis=1, keepdims=True))
    radius = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)) / 2)
    return offset_origins(points, normal, radius).astype(np.float32), directions.astype(np.float32)


def _warp_device() -> str:
    return "cuda" if torch.cuda.is_available() else "cpu"


if __name__ == "__main__":
    main()
