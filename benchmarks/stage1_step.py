"""What an iteration of Stage I costs on a CPU, part by part, against the same iteration in plain torch and serial
kernels.

    python -m benchmarks.stage1_step                            # 512 x 512, 30 K faces, one core
    python -m benchmarks.stage1_step --width 1600 --height 1200 --faces 100000 --cores 2
    python -m benchmarks.stage1_step --json step.json

A ball that fills a quarter of the picture, its photographs drawn from a larger one. Both ways alternate in one run:
medians of processor and wall milliseconds, and their ratios. The plain way is Stage I as it was before the fused
passes: D-SSIM by convolutions, a serial rasteriser, an autograd node for each operation, Adam operation by operation.

Then what each fused pass moves and computes, counted from its source, beside what this machine can: bandwidth of a
triad over arrays beyond the cache, and multiply-adds of vectors, on one core.
"""

from __future__ import annotations

import argparse
import importlib
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
import torch
import warp as wp

from benchmarks.machine import processor
from exmesh_graph.gpu.cores import cores, split
from exmesh_graph.gpu.simd import PRELUDE
from exmesh_graph.io.color import srgb_to_linear
from exmesh_graph.losses import dssim
from exmesh_graph.optim import adam
from exmesh_graph.stage1 import refine
from exmesh_graph.stage1.render import draw, render_carrier
from exmesh_graph.stage1.settings import RefineSettings
from exmesh_graph.stage1.smoothness import Bilaplacian
from exmesh_graph.targets import prepare_targets
from exmesh_graph.testing import latlong_ball, pattern, state
from exmesh_graph.types import Carrier, Stage1State, Views

Row = dict[str, float]
RATE = 0.02
rasterize = importlib.import_module("exmesh_graph.raster.rasterize")  # the package exports a function of this name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--height", type=int, default=512)
    parser.add_argument("--faces", type=int, default=30000)
    parser.add_argument("--texels", type=int, default=512)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=5, help="turns, of three steps each")
    parser.add_argument("--normals", type=float, default=0.0, help="weight of the variation of normals; graphs: 0.02")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    with cores(options.cores):
        loops = prepared(options)
        parts = measured(loops, options.repeats)
    faces = len(loops["fused"].state.faces)
    work = f"{options.width} x {options.height}, {faces} faces, {options.texels}^2 texels"
    print(f"{work}, {options.cores} core(s), {processor()}")
    print(f"{'':34s}{'processor ms':>22s}{'':8s}{'wall ms':>22s}")
    print(f"{'':34s}" + 2 * f"{'plain':>11s}{'fused':>11s}{'ratio':>8s}")
    for name, row in parts.items():
        pairs = [(row[f"plain {clock}"], row[f"fused {clock}"]) for clock in ("processor", "wall")]
        print(f"{name:34s}" + "".join(f"{plain:11.2f}{fused:11.2f}{plain / fused:8.1f}" for plain, fused in pairs))
    limits = machine()
    print(f"\none core: {limits['GB/s']:.1f} GB/s beyond the cache, {limits['GFLOP/s']:.0f} GFLOP/s of vectors")
    shares = roofline(options, loops["fused"], limits)
    print(f"{'':34s}{'ms':>8s}{'bytes':>12s}{'flops':>12s}{'floor ms':>10s}{'share':>8s}")
    for name, row in shares.items():
        print(f"{name:34s}{row['ms']:8.2f}{row['bytes']:12.3g}{row['flops']:12.3g}{row['floor']:10.2f}"
              f"{row['floor'] / row['ms']:8.0%}")  # fmt: skip
    if options.json:
        kept = {"parts": parts, "machine": limits, "roofline": shares}
        options.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


def prepared(options: argparse.Namespace) -> dict[str, refine._Loop]:
    """The loop in both ways, on the same ball and photographs."""
    start, photographs = scene(options)
    made = {}
    for way in ("plain", "fused"):
        with plainly(way == "plain"):
            made[way] = loop_of(start, photographs, normals=options.normals)
    return made


def loop_of(start: Stage1State, photographs: Views, device: str = "cpu", normals: float = 0.0) -> refine._Loop:
    """A loop of Stage I on `device`, its pictures prepared."""
    targets = prepare_targets(photographs, device=device)
    targets.ssim_target(0)
    smooth = Bilaplacian(normals=normals)
    return refine._Loop(start, targets, RefineSettings(iterations=10**6), smooth, 0, "benchmark", device)


def scene(options: argparse.Namespace) -> tuple[Stage1State, Views]:
    """A ball, shrunk, and one photograph of it, of the sizes in `options`."""
    rings = round((options.faces / 4) ** 0.5)
    shape = latlong_ball(rings, 2 * rings, 0.9)
    carrier = Carrier(*shape, pattern(options.texels))
    side = min(options.width, options.height)
    pose = np.eye(4)
    pose[2, 3] = -3.7
    blank = np.zeros((1, options.height, options.width), np.float32)
    intrinsics = np.array([[[1.37 * side, 0, options.width / 2], [0, 1.37 * side, options.height / 2], [0, 0, 1]]])
    views = Views(("v",), np.repeat(blank[..., None], 3, -1), blank, intrinsics, pose[None], "train")
    colours, alpha = render_carrier(carrier, views)
    straight = np.clip(colours / np.maximum(alpha, 1e-6)[..., None], 0, 1)
    photographs = Views(
        views.names,
        (srgb_to_linear(straight) * alpha[..., None]).astype(np.float32),
        alpha,
        intrinsics,
        pose[None],
        "train",
    )
    return state(Carrier(0.99 * shape[0], *shape[1:], carrier.texture), fill=0.5), photographs


@contextmanager
def plainly(really: bool) -> Iterator[None]:
    """Stage I without its fused passes."""
    if not really:
        yield
        return
    in_strips = rasterize.rasterize_projected

    def serial(projected, faces, height, width, near, cull_back, bary):
        return in_strips(projected, faces, height, width, near=near, cull_back=cull_back, bary=bary, large_face=0)

    with (
        patch.object(refine, "painter_of", lambda *_: None),
        patch.object(dssim, "_fused", dssim._by_convolution),
        patch.object(adam, "_MANY", sys.maxsize),
        patch.object(rasterize, "_in_strips", serial),
    ):
        yield


def measured(loops: dict[str, refine._Loop], repeats: int) -> dict[str, Row]:
    """Medians of processor and wall milliseconds of each part, and of a whole step."""
    works = {way: works_of(loop) for way, loop in loops.items()}
    times: dict[str, dict[str, list[float]]] = {}
    for _ in range(repeats):
        for way, named in works.items():
            with plainly(way == "plain"):
                for name, work in named.items():
                    for _ in range(3):
                        began = time.process_time(), time.perf_counter()
                        work()
                        ended = time.process_time(), time.perf_counter()
                        for clock, a, b in zip(("processor", "wall"), began, ended, strict=True):
                            times.setdefault(name, {}).setdefault(f"{way} {clock}", []).append(1000 * (b - a))
    return {name: {of: statistics.median(values) for of, values in row.items()} for name, row in times.items()}


def works_of(loop: refine._Loop) -> dict[str, Callable[[], object]]:
    """The parts of a loop's step, each a call that repeats it."""
    surface, targets = loop.surface, loop.targets
    values = surface.appearance.values
    weights = [
        torch.randn(n, generator=torch.Generator().manual_seed(0)) for n in (values.shape, surface.vertices.shape)
    ]
    size = (targets.height, targets.width)
    upstream = torch.randn(*size, 3), torch.randn(size)
    counter = iter(range(10**9))

    def picture():
        return draw(surface, targets.intrinsics[0], targets.world_to_camera[0], *size, painter=loop.painter)

    def image_terms():
        colour, alpha = drawn.colour.detach().requires_grad_(), drawn.alpha.detach().requires_grad_()
        terms, _ = loop.terms.of(0, drawn._replace(colour=colour, alpha=alpha), surface.vertices.detach())
        picked = [term for name, term in terms.items() if name in ("l1", "d_ssim", "silhouette")]
        return torch.autograd.grad(torch.stack(picked).sum(), (colour, alpha))

    def smoothness():
        return torch.autograd.grad(loop.terms.smoothness.loss(surface.vertices), surface.vertices)

    def with_gradient():
        shown = picture()
        return torch.autograd.grad((shown.colour, shown.alpha), (surface.vertices, values), upstream)

    with plainly(loop.painter is None):
        drawn = picture()
    kept = {name: tensor.detach().clone() for name, tensor in loop.changing().items()}

    def vertices():
        loop.move(1e-4 * weights[1], next(counter), 1e-6)

    def texels():
        loop.appearance.step([1e-7 * weights[0]], next(counter) + 1, RATE, loop.pixel_gradient)

    def whole():
        with torch.no_grad():
            for name, tensor in loop.changing().items():
                tensor.copy_(kept[name])
        loop.step(0)

    return {
        "picture": picture, "picture, with gradient": with_gradient, "image terms, with gradient": image_terms,
        "smoothness, with gradient": smoothness, "vertices' Adam": vertices, "texels' Adam, all of them": texels,
        "step": whole,
    }  # fmt: skip


def machine() -> Row:
    """What one core can: the best of several triads and of several rounds of multiply-adds."""
    size = 1 << 24
    a, b, c = torch.zeros(size), torch.rand(size), torch.rand(size)
    moved, computed = [], []
    for _ in range(7):
        began = time.thread_time()
        split(triad, 1, size, a, b, c, grain=1)
        moved.append(time.thread_time() - began)
        began = time.thread_time()
        split(multiply_add, 1, 1 << 20, c, grain=1)
        computed.append(time.thread_time() - began)
    return {"GB/s": 12e-9 * size / min(moved[1:]), "GFLOP/s": 1e-9 * (1 << 20) * 8 * 8 * 2 / min(computed[1:])}


def roofline(options: argparse.Namespace, loop: refine._Loop, limits: Row) -> dict[str, Row]:
    """Counted bytes and flops of the passes whose work does not depend on the mesh, and the time they take."""
    pixels, values = options.width * options.height, 3 * options.texels**2
    box = loop.targets.box(0)
    work = works_of(loop)
    rows = {
        # x, target and its two statistics read, gradient written; four blurs of three fields, 16 flops a tap pair sum
        "image terms, with gradient": (3 * box.area * 20 + pixels * (3 * 12 + 12), 3 * box.area * 245 + pixels * 20),
        # value and moments read and written, gradient read; a root, two divisions and ten more
        "texels' Adam, all of them": (values * 28, values * 13),
    }
    made = {}
    for name, (moved, computed) in rows.items():
        work[name]()
        seconds = []
        for _ in range(15):
            began = time.thread_time()
            work[name]()
            seconds.append(time.thread_time() - began)
        floor = max(moved / limits["GB/s"], computed / limits["GFLOP/s"]) * 1e-6
        made[name] = {"ms": 1000 * min(seconds), "bytes": moved, "flops": computed, "floor": floor}
    return made


@wp.func_native(
    PRELUDE + "for (int i = 0; i < size; i += LANES) STORE(a.data + i, LOAD(b.data + i) + 3.f * LOAD(c.data + i));"
)
def _triad(size: int, a: wp.array(dtype=float), b: wp.array(dtype=float), c: wp.array(dtype=float)): ...


@wp.kernel
def triad(first: int, size: int, a: wp.array(dtype=float), b: wp.array(dtype=float), c: wp.array(dtype=float)):
    _triad(size, a, b, c)


@wp.func_native(
    PRELUDE
    + """
    vf s[8];
    const vf x = LOAD(c.data), y = LOAD(c.data + 8) * 1e-3f;
    for (int k = 0; k < 8; ++k) s[k] = x + (float)k;
    for (int i = 0; i < rounds; ++i) for (int k = 0; k < 8; ++k) s[k] = __builtin_elementwise_fma(s[k], x, y);
    for (int k = 0; k < 8; ++k) STORE(c.data + 8 * k, s[k]);
"""
)
def _multiply_add(rounds: int, c: wp.array(dtype=float)): ...


@wp.kernel
def multiply_add(first: int, rounds: int, c: wp.array(dtype=float)):
    _multiply_add(rounds, c)


if __name__ == "__main__":
    main()
