"""Seconds of a Stage II step, part by part: fused kernels beside plain torch operations.

    python -m benchmarks.stage2_speed                 # 800 x 800, 2048 maps, a sky of 128 x 256; about two minutes
    python -m benchmarks.stage2_speed --quick         # 200 x 200, 512 maps
    python -m benchmarks.stage2_speed --cores 2       # kernels on two cores (wall seconds tell on a quiet machine)
    python -m benchmarks.stage2_speed --sampled       # Monte Carlo light at the paper's counts, with a normal map

The scene of `benchmarks.stage2_memory`: a sphere on 57 % of each picture; with --sampled it is dented, so that light
bounces. Both ways take the same steps in turns, in
one process; medians of --repeats steps, processor seconds of all threads and wall seconds. Torch keeps one thread.
The last column is the plain way's processor seconds over the fused one's.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.stability import stage2_scenes as scenes
from benchmarks.stage2_memory import pictures
from exmesh_graph.gpu.torch_setup import sharing
from exmesh_graph.optim import Adam
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.shading.transport import trace_transport, with_bounces
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fused import step as fused
from exmesh_graph.stage2.objective import plain_terms, weighted_terms
from exmesh_graph.stage2.settings import DecompositionSettings
from exmesh_graph.types import Transport

Times = dict[str, list[tuple[float, float]]]


def main() -> None:
    options = arguments()
    with sharing(options.cores):
        rows = measure(options)
    print(f"{options.size} x {options.size}, maps {options.texture}, sky {options.sky} x {2 * options.sky}, "
          f"{options.cores} cores: milliseconds of a step, processor (wall)")  # fmt: skip
    print(f"{'':12}{'plain':>18}{'fused':>18}{'ratio':>8}")
    for name, row in rows.items():
        plain, quick = row["plain"], row["fused"]
        both = "".join(f"{1000 * p:10.1f} ({1000 * w:5.0f})" for p, w in (plain, quick))
        print(f"{name:12}{both}{plain[0] / max(quick[0], 1e-9):8.1f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def measure(options: argparse.Namespace) -> dict[str, dict[str, tuple[float, float]]]:
    """{part: {way: (processor seconds, wall seconds)}}, medians."""
    model = build(options)
    ways: dict[str, tuple[Callable, Callable]] = {
        "plain": (plain_terms, plain_adam),
        "fused": (weighted_terms, Adam.step),
    }
    assert fused.serves(model)
    kept = [p.detach().clone() for p in (model.maps.parameter, model.environment, model.factor.parameter)]
    times: dict[str, Times] = {name: {} for name in ways}
    for number in range(options.repeats + 1):
        for name, (terms_of, adam) in ways.items():
            optimiser = Adam([model.maps.parameter, model.environment, model.factor.parameter], [1e-3] * 3)
            found = step(model, optimiser, number % len(model.buffers), terms_of, adam)
            if number:  # the first step of each compiles kernels and fills caches
                for part, pair in found.items():
                    times[name].setdefault(part, []).append(pair)
            with torch.no_grad():
                for parameter, value in zip(optimiser.parameters, kept, strict=True):
                    parameter.copy_(value)
    middle = {name: {part: median(pairs) for part, pairs in parts.items()} for name, parts in times.items()}
    return {part: {name: middle[name][part] for name in ways} for part in middle["plain"]}


def step(
    model: Decomposition, optimiser: Adam, number: int, terms_of: Callable, adam: Callable
) -> dict[str, tuple[float, float]]:
    """One step of a view as the fit takes it: {part: (processor, wall)}."""
    found: dict[str, tuple[float, float]] = {}
    buffer = model.buffers[number]
    with timed(found, "step"):
        with timed(found, "forward"):
            terms, _ = terms_of(model, buffer, model.settings.indirect_ramp)
        with timed(found, "backward"):
            torch.stack(list(terms.values())).sum().backward()
        with timed(found, "check"):
            for parameter in optimiser.parameters:
                assert parameter.grad is not None
                low, high = parameter.grad.aminmax()
                assert max(-float(low), float(high)) < float("inf")
        gradient = model.maps.parameter.grad
        with timed(found, "Adam"):
            adam(optimiser)
        model.maps.spare = gradient if adam is Adam.step else None
    return found


def plain_adam(optimiser: Adam) -> None:
    """Adam's step by torch's operations in turn, which float64 takes, at float32's size."""
    optimiser.steps += 1
    for parameter, first, second in zip(optimiser.parameters, optimiser.first, optimiser.second, strict=True):
        gradient, parameter.grad = parameter.grad, None
        with torch.no_grad():
            first.lerp_(gradient, 0.1)
            second.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
            scale = (second.sqrt() / (1 - 0.999**optimiser.steps) ** 0.5).add_(1e-8)
            parameter.addcdiv_(first, scale, value=-1e-3 / (1 - 0.9**optimiser.steps))


@contextmanager
def timed(found: dict[str, tuple[float, float]], part: str) -> Iterator[None]:
    busy, began = time.process_time(), time.perf_counter()
    yield
    found[part] = (time.process_time() - busy, time.perf_counter() - began)


def median(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    return statistics.median(p for p, _ in pairs), statistics.median(w for _, w in pairs)


def build(options: argparse.Namespace, device: str = "cpu") -> Decomposition:
    """The model, away from its uniform start."""
    texture = np.full((options.texture, options.texture, 3), 0.5, np.float32)
    carrier = replace(scenes.sphere(), texture=texture)
    if options.sampled:
        waves = np.sin(10 * carrier.vertices).prod(axis=1, keepdims=True)
        carrier = replace(carrier, vertices=(carrier.vertices * (1 + 0.35 * waves)).astype(np.float32))
    views = pictures(carrier, 3, options.size)
    subdivision = next(n for n in range(1, 17) if len(carrier.faces) / 2 * n * n >= options.points)
    light: Transport | MonteCarloSettings = MonteCarloSettings(independent_gradient=False)
    if not options.sampled:
        light = with_bounces(trace_transport(carrier.vertices, carrier.faces, 128, subdivision), 1)
    settings = DecompositionSettings(
        environment_height=options.sky, ssim_weight=options.ssim_weight, normal_map=options.sampled
    )
    model = Decomposition(carrier, views, light, settings, device)
    model.start()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in (model.maps.parameter, model.environment):
            parameter += 0.3 * torch.randn(parameter.shape, generator=generator).to(parameter)
    return model


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stage2_speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--size", type=int, default=800)
    parser.add_argument("--texture", type=int, default=2048)
    parser.add_argument("--sky", type=int, default=128, help="rows of the environment")
    parser.add_argument("--points", type=int, default=50_000, help="of the light transport, about")
    parser.add_argument("--sampled", action="store_true", help="Monte Carlo light in place of precomputed transport")
    parser.add_argument("--ssim-weight", type=float, default=0.2)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.size, options.texture, options.points, options.sky = 200, 512, 12_000, 64
    return options


if __name__ == "__main__":
    main()
