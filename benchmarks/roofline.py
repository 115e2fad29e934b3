"""How near each fused pass comes to what this machine can do, and what more cores would make of a step.

    python -m benchmarks.roofline                     # Stage I at 512 x 512, Stage II at 800 x 800, PGSR at 256 x 256
    python -m benchmarks.roofline --stage stage1 --size 1024 --faces 100000
    python -m benchmarks.roofline --cores 2           # wall milliseconds of a step on one core and on two, in turns

One core. For each kernel of a step: processor milliseconds (the least of several steps: what else runs on a machine
only adds), the bytes that it must move and
the arithmetic that it does, counted from its source, and the floor: the longer of both at this machine's bandwidth
(a triad over arrays beyond the cache) and multiply-adds (of vectors that stay in registers). What a cache holds is not
counted as moved, so that the floor is low rather than high. "share" is the floor over the time: what is reached of the
limit. Kernels whose work depends on what lies under a pixel (Gaussians) are timed, not counted.

The last lines are a model, not a measurement: a launch that cores share takes 1 / n of its time on n cores, or as much
as its pieces allow; all the rest of a step takes what it takes on one.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import torch

from benchmarks.machine import processor
from exmesh_graph.gpu import cores as shared
from exmesh_graph.gpu import warp_runtime
from exmesh_graph.gpu.torch_setup import sharing

ROOT = Path(__file__).parents[1]
MODELLED = (2, 8, 32)
Counts = Mapping[str, tuple[float, float]]


class Step(NamedTuple):
    """A stage's step, to be called again and again, and {kernel: (bytes, flops)} of one."""

    label: str
    take: Callable[[], object]
    counts: Callable[[], Counts]


def main() -> None:
    options = arguments()
    torch.set_num_threads(1)
    limits = machine()
    print(f"{processor()}: {limits['GB/s']:.1f} GB/s beyond the cache, {limits['GFLOP/s']:.0f} GFLOP/s, one core")
    kept: dict[str, Any] = {"machine": limits}
    for name in options.stage or list(STAGES):
        with sharing(1):
            step = STAGES[name](options)
            row = measured(step, options.repeats)
        kept[name] = row | {"floors": floors(step.counts(), row["kernels"], limits)}
        print("\n".join(lines(step.label, kept[name])), flush=True)
        if options.cores > 1:
            kept[name]["wall"] = walls(step, options.cores, options.repeats)
            one, many = kept[name]["wall"]
            print(f"  on the clock: {one:.1f} ms on one core, {many:.1f} on {options.cores}: {one / many:.2f} times")
    if options.json:
        options.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


def measured(step: Step, repeats: int) -> dict[str, Any]:
    """Processor milliseconds of a step, of each kernel in it, whether cores share it, and its items."""
    for _ in range(3):
        step.take()
    whole: list[float] = []
    found: dict[str, list[float]] = {}
    facts: dict[str, tuple[bool, int]] = {}
    for _ in range(repeats):
        with recording() as launches:
            began = time.process_time()
            step.take()
            whole.append(1000 * (time.process_time() - began))
        sums: dict[str, float] = {}
        for kernel, items, seconds in launches:
            sums[kernel.key] = sums.get(kernel.key, 0.0) + 1000 * seconds
            facts[kernel.key] = (kernel in shared._launched, items)
        for key, value in sums.items():
            found.setdefault(key, []).append(value)
    kernels = {
        key: {"ms": min(values), "shared": facts[key][0], "items": facts[key][1]}
        for key, values in sorted(found.items(), key=lambda pair: -min(pair[1]))
    }
    return {"ms": min(whole), "kernels": kernels}


@contextmanager
def recording() -> Iterator[list[tuple[Any, int, float]]]:
    """(kernel, items, seconds) of each launch within the block, all on one core."""
    launches: list[tuple[Any, int, float]] = []
    plain = warp_runtime.launch_converted

    def timed(kernel: Any, size: Any, converted: Any) -> None:
        began = time.thread_time()
        plain(kernel, size, converted)
        launches.append((kernel, size if isinstance(size, int) else size[0], time.thread_time() - began))

    with patch.object(warp_runtime, "launch_converted", timed), patch.object(shared, "launch_converted", timed):
        yield launches


def floors(counts: Counts, kernels: Mapping[str, Any], limits: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Of the kernels that were counted: bytes, flops, milliseconds of either at the machine's limit."""
    rows = {}
    for key, (moved, computed) in counts.items():
        if key in kernels:
            by_bytes, by_flops = 1e-6 * moved / limits["GB/s"], 1e-6 * computed / limits["GFLOP/s"]
            rows[key] = {"bytes": moved, "flops": computed, "by_bytes": by_bytes, "by_flops": by_flops}
    return rows


def modelled(row: Mapping[str, Any], cores: int) -> float:
    """Milliseconds of a step on so many cores, if shared launches divide evenly over them or over their items."""
    parts = [kernel for kernel in row["kernels"].values() if kernel["shared"]]
    serial = row["ms"] - sum(kernel["ms"] for kernel in parts)
    return serial + sum(kernel["ms"] / min(cores, max(kernel["items"], 1)) for kernel in parts)


def walls(step: Step, cores: int, repeats: int) -> tuple[float, float]:
    """Milliseconds on the clock, medians in turns: on one core, on `cores`."""
    times: dict[int, list[float]] = {1: [], cores: []}
    for _ in range(repeats):
        for count, found in times.items():
            with sharing(count):
                began = time.perf_counter()
                step.take()
                found.append(1000 * (time.perf_counter() - began))
    return statistics.median(times[1]), statistics.median(times[cores])


def lines(label: str, row: Mapping[str, Any]) -> list[str]:
    """A stage's table."""
    text = [f"\n{label}: {row['ms']:.2f} ms of a processor a step",
            f"  {'':22s}{'ms':>8s}{'of step':>9s}{'MB':>9s}{'Mflop':>9s}{'floor':>8s}{'share':>7s}"]  # fmt: skip
    for key, kernel in row["kernels"].items():
        ms, floor = kernel["ms"], row["floors"].get(key)
        begin = f"  {key:22s}{ms:8.2f}{ms / row['ms']:9.0%}"
        if floor is None:
            text.append(begin + ("" if kernel["shared"] else f"{'':33s}  one core"))
            continue
        least = max(floor["by_bytes"], floor["by_flops"])
        bound = "memory" if floor["by_bytes"] > floor["by_flops"] else "arithmetic"
        text.append(
            f"{begin}{floor['bytes'] / 1e6:9.2f}{floor['flops'] / 1e6:9.1f}{least:8.2f}{least / ms:7.0%}  {bound}"
        )
    kernels = sum(kernel["ms"] for kernel in row["kernels"].values())
    parts = sum(kernel["ms"] for kernel in row["kernels"].values() if kernel["shared"])
    text.append(f"  {'outside of kernels':22s}{row['ms'] - kernels:8.2f}{1 - kernels / row['ms']:9.0%}")
    model = ", ".join(f"{row['ms'] / modelled(row, n):.1f} on {n}" for n in MODELLED)
    text.append(f"  serial {1 - parts / row['ms']:.0%}; a model, no measurement: times as fast {model} cores")
    return text


def machine() -> dict[str, float]:
    from benchmarks import stage1_step

    return stage1_step.machine()


def stage1(options: argparse.Namespace) -> Step:
    from benchmarks import stage1_step

    size = options.size or 512
    loop = stage1_step.prepared(
        argparse.Namespace(width=size, height=size, faces=options.faces, texels=options.texels, normals=0.0)
    )["fused"]  # fmt: skip
    number = iter(range(10**9))

    def counts() -> Counts:
        cover, targets = loop.painter.cover, loop.targets
        faces, vertices, edges = len(loop.state.faces), len(loop.state.vertices), len(loop.surface.edges.edges)
        pixels, shown = size * size, int((cover.face_id >= 0).sum())
        boxes = cover.boxes.long()
        looked = int(((boxes[:, 2] - boxes[:, 0] + 1) * (boxes[:, 3] - boxes[:, 1] + 1)).clamp(min=0).sum())
        box, values = 3 * targets.box(0).area, 3 * options.texels**2
        moved = 3 * int((loop.appearance.moments.second > 0).any(-1).sum())  # the other texels are only looked at
        twice = len(loop.painter.band_faces) / faces  # a face that lies in two bands of the texture is walked twice
        place = 65  # of a pixel: six edge rows, three products, a division, the place in the atlas, the texel
        return {
            "sort_faces": (faces * (12 + 18) + 12 * vertices, faces * 65),
            "cover_strips": (pixels * 24 + faces * 28, looked * 24),
            "paint_faces": (shown * (4 + 12 + 24) + faces * 24, shown * (place + 27)),
            "paint_adjoint": (
                shown * (4 + 12 + 2 * 24) * twice + 4 * values + faces * 60, shown * twice * (place + 24) + shown * 95,
            ),
            "gather_vertices": (faces * (36 + 12) + vertices * 24, faces * 9),
            "mark_silhouette": (edges * 17 + vertices * 12, edges * 45),
            "compare_strips": (pixels * (3 * 12 + 12) + box * 8, pixels * 20 + 2 * box),
            "ssim_strips": (box * 20, box * 245),
            "adam_blocks": (values * 12 + moved * 16, moved * 13),
            "umbrella": (4 * (vertices * 32 + 2 * edges * 4), 4 * (2 * edges * 4 + vertices * 12)),
            "step_vertices": (vertices * 92, vertices * 40),
            "count_turned": (faces * 13 + vertices * 12, int(cover.shown.sum()) * 14),
        }  # fmt: skip

    label = f"Stage I, {size} x {size}, {len(loop.state.faces)} faces, {options.texels}^2 texels"
    return Step(label, lambda: loop.step(next(number)), counts)


def stage2(options: argparse.Namespace) -> Step:
    from benchmarks import stage2_speed
    from exmesh_graph.optim import Adam

    size = options.size or 800
    given = argparse.Namespace(size=size, texture=options.maps, sky=128, points=50_000, ssim_weight=0.2)
    model = stage2_speed.build(given)
    optimiser = Adam([model.maps.parameter, model.environment, model.factor.parameter], [1e-4] * 3)
    number = iter(range(10**9))

    def take() -> None:
        at = next(number) % len(model.buffers)
        stage2_speed.step(model, optimiser, at, stage2_speed.weighted_terms, Adam.step)

    def counts() -> Counts:
        operators, buffer = model.light.operators, model.buffers[0]
        seen, box = len(buffer.pixel), 3 * buffer.box[0] * buffer.box[1]
        points, lights = operators.transfer.shape
        texels, channels = model.maps.parameter.shape
        read = seen + points
        bounced = 0 if operators.gather is None else 2 * len(operators.gather.values())
        stack = model.light.stack
        sky = int((stack.heights * stack.widths).sum())
        matrices = 2 * sum(group.kernel.numel() for group in stack.groups)  # forward and back
        return {
            "read_maps": (read * (32 + 16 + 2 * 32), read * (4 * channels * 22 + 32)),
            "scatter_maps": (read * (36 + 16) + texels * channels * 8, read * 32 + texels * channels * 22),
            # a record of 21 floats, what a pixel knows of its light and its photograph, its colours
            "shade_view": (seen * (84 + 24 + 28 + 32 + 16 + 16 + 28), seen * (110 + 80 + 100 + 3 * 150 + 80)),
            "pull_back": (seen * (84 + 24 + 28 + 12 + 24 + 16 + 16), seen * (110 + 3 * 85 + 140)),
            "add_pieces": (8 * 16 * (points + sky), 8 * 4 * (points + sky)),
            "direct": (4 * points * lights, 6 * points * lights),
            "direct_adjoint": (4 * points * lights, 6 * points * lights),
            "mix_frequencies": (4 * matrices, 12 * matrices),
            **({"sparse": (bounced * 8, bounced * 6)} if bounced else {}),
            "ssim_strips": (box * 20, box * 245),
            "adam_blocks": (texels * channels * 28, texels * channels * 13),
        }

    return Step(f"Stage II, {size} x {size}, {options.maps} maps", take, counts)


def pgsr(options: argparse.Namespace) -> Step:
    from benchmarks import splat

    size = options.size or 256
    views = splat.load_blender(ROOT / "graphs" / "samples" / "spot", splat.BlenderOptions(max_views=12)).train
    targets = splat.prepare_targets(views)
    settings = splat.PgsrSettings(iterations=1000, count=options.gaussians, max_gaussians=options.gaussians + 1)
    gaussians = splat.started(views, targets, settings, None, 0, lambda message: None, "benchmark")
    gaussians.opacities[:] = 1.0
    adam = splat.GaussianAdam(gaussians)
    fit, density = splat.FusedStep(splat.Pictures(targets, settings, 0), adam), splat.Density(
        len(gaussians), gaussians.means
    )  # fmt: skip
    rates = {"means": 1e-4, "scales": 5e-3, "rotations": 2e-3, "opacities": 0.05, "sh": 5e-3, "sh_rest": 2.5e-4}
    number = iter(range(10**9))

    def take() -> None:
        k = next(number)
        fit.loss(k % len(targets), 700 + k)
        fit.update(density, rates)

    return Step(f"PGSR, {size} x {size}, {options.gaussians} Gaussians", take, dict)


STAGES: dict[str, Callable[[argparse.Namespace], Step]] = {"stage1": stage1, "stage2": stage2, "pgsr": pgsr}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.roofline",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--stage", action="append", choices=list(STAGES), help="default: all")
    parser.add_argument("--size", type=int, help="side of the pictures (of Stage I and II)")
    parser.add_argument("--faces", type=int, default=30_000)
    parser.add_argument("--texels", type=int, default=512, help="side of Stage I's texture")
    parser.add_argument("--maps", type=int, default=2048, help="side of Stage II's maps")
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--cores", type=int, default=1, help="beside one: a step on the clock")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
