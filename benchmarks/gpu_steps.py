"""What a step of each fit costs on CUDA, beside the same machine's CPU cores.

    python -m benchmarks.gpu_steps                        # CUDA, then 1, 2, 4 ... cores of this machine
    python -m benchmarks.gpu_steps --quick --cores 1 2    # small sizes; the CPU alone where there is no GPU
    python -m benchmarks.gpu_steps --case "Stage II" --json FILE

Wall milliseconds, medians of --repeats steps after three. The GPU's busy share is the time of its kernels over the wall
time of the same steps, as torch's profiler sees both: what is missing to 100 % is the GPU waiting for Python. Stage I
and Stage II have the scenes of `stage1_step` and `stage2_speed`, Gaussians start as `splat --steps` does.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from argparse import Namespace
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import torch

from benchmarks import stage1_step, stage2_speed
from benchmarks.machine import processor
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.io.blender import load_blender
from exmesh_graph.io.settings import BlenderOptions
from exmesh_graph.optim import Adam
from exmesh_graph.splat.fit import _Fit
from exmesh_graph.splat.pgsr import started
from exmesh_graph.splat.settings import PgsrSettings
from exmesh_graph.stage2.objective import weighted_terms
from exmesh_graph.targets import prepare_targets

Step = Callable[[], object]
SAMPLE = Path(__file__).parents[1] / "graphs" / "samples" / "spot"


def main() -> None:
    options = arguments()
    devices = {"cuda": [1]} if torch.cuda.is_available() else {}
    devices["cpu"] = options.cores
    gpu = torch.cuda.get_device_name() if "cuda" in devices else "no GPU"
    print(f"{gpu}; {processor()}, torch {torch.__version__}")
    rows: list[dict[str, Any]] = []
    for name, make in cases(options.quick).items():
        if options.case and not any(name.startswith(case) for case in options.case):
            continue
        for device, counts in devices.items():
            with sharing(max(counts, default=1)):
                step = make(device)
            for count in counts:
                with sharing(count):
                    row = {"case": name, "device": device, "cores": count, **measured(step, device, options.repeats)}
                rows.append(row)
                print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def cases(quick: bool) -> dict[str, Callable[[str], Step]]:
    """{what: a function that makes its step on a device}."""
    if quick:
        return {
            "Stage I, 200 x 150, 3 K faces": lambda d: stage1(d, 200, 150, 3000, 256),
            "Stage II, 200 x 200, 512 maps": lambda d: stage2(d, 200, 512, 12_000, 64),
            "Stage II, sampled light, 200 x 200, 512 maps": lambda d: stage2(d, 200, 512, 12_000, 64, sampled=True),
            "Gaussians, 128 x 128, 2 K": lambda d: gaussians(d, 2, 2000),
        }
    return {
        "Stage I, 512 x 512, 30 K faces": lambda d: stage1(d, 512, 512, 30_000, 512),
        "Stage I, 1600 x 1200, 100 K faces": lambda d: stage1(d, 1600, 1200, 100_000, 1024),
        "Stage I, 4096 x 3072, 400 K faces": lambda d: stage1(d, 4096, 3072, 400_000, 4096),
        "Stage II, 800 x 800, 2048 maps": lambda d: stage2(d, 800, 2048, 50_000, 128),
        "Stage II, 1600 x 1600, 4096 maps": lambda d: stage2(d, 1600, 4096, 50_000, 128),
        "Stage II, sampled light, 800 x 800, 2048 maps": lambda d: stage2(d, 800, 2048, 50_000, 128, sampled=True),
        "Gaussians, 256 x 256, 20 K": lambda d: gaussians(d, 1, 20_000),
        "Gaussians, 256 x 256, 100 K": lambda d: gaussians(d, 1, 100_000),
    }


def stage1(device: str, width: int, height: int, faces: int, texels: int) -> Step:
    loop = stage1_step.loop_of(*_ball(width, height, faces, texels), device)
    kept = {name: tensor.detach().clone() for name, tensor in loop.changing().items()}

    def step() -> None:
        loop.step(0)
        with torch.no_grad():  # the same step again
            for name, tensor in loop.changing().items():
                tensor.copy_(kept[name])

    return step


@cache
def _ball(width: int, height: int, faces: int, texels: int) -> Any:
    return stage1_step.scene(Namespace(width=width, height=height, faces=faces, texels=texels))


def stage2(device: str, size: int, texture: int, points: int, sky: int, sampled: bool = False) -> Step:
    options = Namespace(size=size, texture=texture, points=points, sky=sky, sampled=sampled, ssim_weight=0.2)
    model = stage2_speed.build(options, device)
    optimiser = Adam([model.maps.parameter, model.environment, model.factor.parameter], [1e-4] * 3)
    numbers = iter(range(10**9))

    def step() -> None:
        number = next(numbers)
        terms, _ = weighted_terms(model, model.buffers[number % len(model.buffers)], number)
        torch.stack(list(terms.values())).sum().backward()
        optimiser.step()

    return step


def gaussians(device: str, downscale: int, count: int) -> Step:
    views = load_blender(SAMPLE, BlenderOptions(downscale=downscale, max_views=12)).train
    settings = PgsrSettings(iterations=1000, count=count, max_gaussians=count + 1)
    targets = prepare_targets(views, device=device)
    cloud = started(views, targets, settings, None, 0, lambda message: None, "benchmark").map(lambda t: t.to(device))
    cloud.opacities[:] = 1.0
    fit = _Fit(cloud, targets, settings, 0, "benchmark")
    numbers = iter(range(700, 10**9))  # all terms act
    return lambda: fit.step(next(numbers))


def measured(step: Step, device: str, repeats: int) -> dict[str, float]:
    """Wall milliseconds of a step; on CUDA also its kernels' busy share, and the memory it took at most."""
    cuda = device == "cuda"

    def timed() -> float:
        began = time.perf_counter()
        step()
        if cuda:
            torch.cuda.synchronize()
        return 1000 * (time.perf_counter() - began)

    if cuda:
        torch.cuda.reset_peak_memory_stats()
    for _ in range(3):
        timed()
    row = {"ms": statistics.median(timed() for _ in range(repeats))}
    if cuda:
        row |= {"busy": busy(timed, 5), "GiB": torch.cuda.max_memory_allocated() / 2**30}
    return row


def busy(timed: Callable[[], float], count: int) -> float:
    """Share of the wall time of `count` steps in which the GPU's kernels run."""
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CUDA]) as seen:
        wall = sum(timed() for _ in range(count))
    return sum(event.self_device_time_total for event in seen.key_averages()) / 1000 / wall


def line(row: dict[str, Any]) -> str:
    where = "CUDA" if row["device"] == "cuda" else f"{row['cores']} cores"
    more = f"   busy {row['busy']:.0%}, {row['GiB']:.2f} GiB" if "busy" in row else ""
    return f"{row['case']:48}{where:>9}{row['ms']:10.2f} ms{more}"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu_steps",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    available = len(os.sched_getaffinity(0))
    doubled = [2**k for k in range(10) if 2**k <= available]
    parser.add_argument("--cores", type=int, nargs="*", default=doubled, help="CPU cores to measure with")
    parser.add_argument("--case", action="append", help="only cases that begin so")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
