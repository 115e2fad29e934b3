"""Planar Gaussians drawn forward and backward: milliseconds by number and size, by Warp's kernels and by native passes.

    python -m benchmarks.splat [--quick] [--cores 2] [--json FILE]
    python -m benchmarks.splat --steps SCENE [--cores 2]          # whole iterations of `init.pgsr`, plain and fused
    python -m benchmarks.splat --fit SCENE [--iterations 500]     # how deep the fitted surface lies

--fit: Gaussians from the hull of a scene with a true mesh, as `init.pgsr` fits them; PSNR of the training views, and
the error of their depth in thousandths of the true mesh's radius, by the middle plane and by the blended one, before
any pixel is added outward. A positive mean lies inside the object.

All else is taken in turns in one process: Warp's kernels (on one core, as they always are) and native passes, which
share --cores. Iterations have all terms, and start from Gaussians in the hull that are 0.73 opaque.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from benchmarks.register import choosing
from exmesh_graph.evaluate.metrics.mesh import bounding_radius
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.raster import rasterize
from exmesh_graph.splat.density import Density
from exmesh_graph.splat.depths import depth_maps
from exmesh_graph.splat.fused.step import FusedStep
from exmesh_graph.splat.gaussians import Gaussians
from exmesh_graph.splat.optimiser import GaussianAdam
from exmesh_graph.splat.pgsr import pgsr, started
from exmesh_graph.splat.pictures import Pictures
from exmesh_graph.splat.plain import PlainStep
from exmesh_graph.splat.render import render
from exmesh_graph.splat.settings import DepthSettings, PgsrSettings
from exmesh_graph.targets import prepare_targets
from tests.splat.splat_reference import render_reference


def shell(count: int, axis: float, seed: int = 0) -> Gaussians:
    """Flat Gaussians on a sphere of radius 0.8, of standard deviation `axis` along it."""
    g = torch.Generator().manual_seed(seed)
    means = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    half = torch.nn.functional.normalize(means + torch.tensor([0.0, 0.0, 1.0001]), dim=1)
    turn = torch.stack([torch.zeros(count), half[:, 0], half[:, 1], half[:, 2]], dim=1)  # takes z to the mean
    scales = torch.tensor([axis, axis, axis / 10]).log().expand(count, 3).clone()
    sh = 0.3 * torch.randn(count, 16, 3, generator=g)
    return Gaussians(0.8 * means, scales, turn, 2 * torch.rand(count, generator=g), sh)


def camera(size: int) -> tuple[torch.Tensor, torch.Tensor]:
    f = 1.56 * size
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 3.7
    return torch.tensor([[f, 0, size / 2 + 3.3], [0, f, size / 2 - 2.1], [0, 0, 1.0]], dtype=torch.float64), pose


def measure(gaussians: Gaussians, size: int, repeats: int, draw=render) -> dict[str, float]:
    """Medians, in ms of this process's wall clock and processor time."""
    gaussians = gaussians.map(lambda t: t.detach().requires_grad_())
    rows = []
    for _ in range(repeats + 1):
        clocks = [(time.perf_counter(), time.process_time())]
        drawing = draw(gaussians, *camera(size), size, size)
        clocks.append((time.perf_counter(), time.process_time()))
        planes = [drawing] if isinstance(drawing, torch.Tensor) else drawing[:4]
        sum(plane.square().sum() for plane in planes).backward()
        clocks.append((time.perf_counter(), time.process_time()))
        rows.append([1e3 * (b[i] - a[i]) for a, b in pairwise(clocks) for i in (0, 1)])
    middle = [statistics.median(column) for column in zip(*rows[1:], strict=True)]
    return dict(zip(("forward", "forward_cpu", "backward", "backward_cpu"), middle, strict=True))


def plain_render(*arguments, **options):
    return render(*arguments, **options, native=False)


def steps(path: Path, cases: list[tuple[int, int]], repeats: int) -> list[dict[str, float]]:
    """Iterations of a fit to a scene, plain and fused in turns, of (downscale, Gaussians); prints a row each."""
    table = []
    print(f"{'picture':>9} {'Gaussians':>9} {'plain':>14} {'fused':>14} {'ratio':>11}   ms: processor, wall")
    for downscale, count in cases:
        views = load_blender(path, BlenderOptions(downscale=downscale, max_views=12)).train
        targets, settings = prepare_targets(views), PgsrSettings(iterations=1000, count=count, max_gaussians=count + 1)
        pictures, ways = Pictures(targets, settings, 0), []
        for way in (PlainStep, FusedStep):
            gaussians = started(views, targets, settings, None, 0, lambda message: None, "benchmark")
            gaussians.opacities[:] = 1.0
            adam = GaussianAdam(gaussians)
            ways.append((way(pictures, adam), Density(len(gaussians), gaussians.means), adam))
        rates = {"means": 1e-4, "scales": 5e-3, "rotations": 2e-3, "opacities": 0.05, "sh": 5e-3, "sh_rest": 2.5e-4}
        times: list[list[tuple[float, float]]] = [[], []]
        for k in range(repeats + 2):
            for (step, density, _), clocks in zip(ways, times, strict=True):
                wall, processor = time.perf_counter(), time.process_time()
                step.loss(k % len(targets), 700 + k)
                step.update(density, rates)
                clocks.append((1e3 * (time.process_time() - processor), 1e3 * (time.perf_counter() - wall)))
        (plain, plain_wall), (fused, fused_wall) = (
            [statistics.median(column) for column in zip(*clocks[2:], strict=True)] for clocks in times
        )
        table.append({
            "height": views.height, "width": views.width, "gaussians": count, "plain": plain, "plain_wall": plain_wall,
            "fused": fused, "fused_wall": fused_wall,
        })  # fmt: skip
        size, ratios = f"{views.width}x{views.height}", f"{plain / fused:5.1f}{plain_wall / fused_wall:6.1f}"
        print(f"{size:>9} {count:9d} {plain:7.0f}{plain_wall:7.0f} {fused:7.1f}{fused_wall:7.1f} {ratios}")
    return table


def fitted(path: Path, iterations: int, quick: bool) -> dict[str, float]:
    """PSNR and depth errors of a fit; prints them."""
    scene = load_blender(path, BlenderOptions(downscale=4 if quick else 1))
    truth, views = scene.truth, scene.train
    if truth is None or truth.mesh_vertices is None or truth.mesh_faces is None:
        raise SystemExit("the scene has no true mesh")
    began = time.process_time()
    gaussians, history = pgsr(views, PgsrSettings(iterations=50 if quick else iterations))
    row = {"iterations": iterations, "psnr": history["psnr"][-1], "seconds": time.process_time() - began}
    print(f"{len(gaussians)} Gaussians, {row['psnr']:.1f} dB, {row['seconds']:.0f} processor seconds")
    faces = torch.from_numpy(np.ascontiguousarray(truth.mesh_faces, np.int32))
    corners = torch.from_numpy(np.ascontiguousarray(truth.mesh_vertices, np.float32))
    cameras = torch.from_numpy(views.intrinsics), torch.from_numpy(views.world_to_camera)
    true = rasterize(corners, faces, *cameras, views.height, views.width).depth.numpy()
    unit = 1000 / bounding_radius(truth.mesh_vertices)
    for surface in ("middle", "blended"):
        keep = DepthSettings(surface=surface, outward=0.0)  # type: ignore[arg-type]
        depth = depth_maps(Gaussians.of(gaussians), prepare_targets(views), keep)[0].depth
        error = unit * (depth - true)[(depth > 0) & (true > 0)]
        row[surface] = float(np.median(np.abs(error)))
        print(f"  {surface} plane: median depth error {row[surface]:.1f}, mean {error.mean():+.1f} thousandths")
    pixel = unit * np.median(true[true > 0]) / views.intrinsics[0, 0, 0]
    print(f"  a pixel is {pixel:.1f} thousandths")
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.splat", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fit", type=Path, metavar="SCENE", help="fit this scene instead of timing")
    parser.add_argument("--iterations", type=int, default=500, help="of the fit")
    parser.add_argument("--steps", type=Path, metavar="SCENE", help="time iterations on this scene")
    parser.add_argument("--gaussians", type=int, default=20_000, help="of the iterations")
    parser.add_argument("--downscale", type=int, default=1, help="of the iterations' pictures")
    parser.add_argument("--cores", type=int, default=1, help="that native passes share")
    parser.add_argument("--quick", action="store_true", help="the 30 K row alone, three repeats")
    parser.add_argument("--json", type=Path, help="write the table here too")
    options = parser.parse_args()
    if options.fit:
        choosing(options.fit)
    cases = [(30_000, 0.008, 256)]
    if not options.quick:
        cases += [(10_000, 0.014, 256), (30_000, 0.03, 256), (100_000, 0.005, 256), (100_000, 0.005, 800)]
    with sharing(options.cores):
        if options.fit:
            result: object = fitted(options.fit, options.iterations, options.quick)
        elif options.steps:
            result = steps(options.steps, [(options.downscale, options.gaussians)], 5 if options.quick else 15)
        else:
            result = drawn(cases, 3 if options.quick else 9)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def drawn(cases: list[tuple[int, float, int]], repeats: int) -> dict[str, object]:
    """Pictures of (Gaussians, standard deviation in world units, side), forward and backward; prints a row each."""
    table = []
    print(
        f"{'Gaussians':>9} {'axis px':>7} {'picture':>7} {'forward':>15} {'backward':>15}   ms: Warp's kernels, native"
    )
    for count, axis, size in cases:
        plain, native = (measure(shell(count, axis), size, repeats, draw) for draw in (plain_render, render))
        pixels = axis * 1.56 * size / 2.9
        table.append({"gaussians": count, "axis": pixels, "size": size, "plain": plain, "native": native})
        print(f"{count:9d} {pixels:7.1f} {size:7d} {plain['forward_cpu']:7.1f} {native['forward']:7.1f} "
              f"{plain['backward_cpu']:7.1f} {native['backward']:7.1f}")  # fmt: skip
    small = [measure(shell(1000, 0.04), 48, 3, draw) for draw in (plain_render, render_reference)]
    both = [row["forward_cpu"] + row["backward_cpu"] for row in small]
    print(f"1000 Gaussians, 48 x 48: plain torch takes {both[1] / both[0]:.0f} times as long as Warp's kernels")
    return {"rows": table, "plain_torch_ratio": both[1] / both[0]}


if __name__ == "__main__":
    main()
