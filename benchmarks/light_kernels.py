"""What fusing the sum over light samples buys: one set of samples shaded by the Warp kernels and by plain torch.

    python -m benchmarks.light_kernels             # under a minute
    python -m benchmarks.light_kernels --quick

Scene, points and sky are those of `light_curve`. Processor milliseconds of drawing and tracing the samples, of their
sum and of its gradient in normals, materials and sky, least of --repeats in turns; then how far the fused value and
gradient differ from plain torch in float64.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import torch

from benchmarks import light_scene
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Material, MonteCarloLight
from exmesh_graph.shading.monte_carlo.samples import LightSamples
from exmesh_graph.shading.monte_carlo.shade import shade, shade_reference
from exmesh_graph.shading.settings import MonteCarloSettings

Way = Callable[..., torch.Tensor]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.light_kernels",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--size", type=int, default=90, help="pixels on a side")
    parser.add_argument("--samples", type=int, default=64, help="of direct light at a point, half of each technique")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--quick", action="store_true", help="a quarter of the points, three repeats")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    if options.quick:
        options.size, options.repeats = options.size // 2, 3
    torch.set_num_threads(1)
    scene = light_scene.build(options.size, metallic=True)
    points, sky = scene.points(), scene.sky
    material = scene.material(scene.attributes, scene.face, scene.bary)
    light = MonteCarloLight(
        scene.surface,
        scene.tracer(1),
        MonteCarloSettings(technique="mis", samples=options.samples, bounces=0),
    )
    best: dict[str, list[float]] = {}
    drawn = float("inf")
    for _ in range(options.repeats + 1):  # the first one compiles
        began = time.process_time()
        samples = light.draw(points, material, None, EnvSampler(sky), 0).direct
        drawn = min(drawn, 1000 * (time.process_time() - began))
        for name, way in (("fused", shade), ("torch", shade_reference)):
            forward, both, _ = step(way, samples, points, material, sky)
            best.setdefault(name, [forward, both])
            best[name] = [min(a, b) for a, b in zip(best[name], (forward, both), strict=True)]
    rows = {name: {"forward": a, "backward": b - a} for name, (a, b) in best.items()}
    print(f"{len(points)} points, {len(points) * options.samples} samples; processor ms")
    print(f"  drawing and tracing: {drawn:.1f}")
    for name, row in rows.items():
        print(f"  {name}: {row['forward']:.1f} forward, {row['backward']:.1f} backward")
    single = step(shade, samples, points, material, sky)[2]
    exact = step(shade_reference, samples, points, material, sky.double())[2]
    error = max(float((a - b).norm() / b.norm()) for a, b in zip(single, exact, strict=True))
    print(f"value and gradient from float64: {error:.1e}")
    if options.json:
        record = {"samples": len(points) * options.samples, "ms": rows, "error": error, "drawing": drawn}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def step(way: Way, samples: LightSamples, points, material: Material, sky: torch.Tensor):  # type: ignore[no-untyped-def]
    """(ms of the value, ms of value and gradient, value and gradients)."""
    leaves = [t.detach().to(sky).clone().requires_grad_() for t in (points.normal, *vars(material).values(), sky)]
    normal, *attributes, environment = leaves
    began = time.process_time()
    image = way(samples, normal, points.view.to(sky), Material(*attributes), environment)
    middle = time.process_time()
    gradients = torch.autograd.grad(image.sum(), leaves)
    ms = 1000 * (middle - began), 1000 * (time.process_time() - began)
    return *ms, [image.detach(), *gradients]


if __name__ == "__main__":
    main()
