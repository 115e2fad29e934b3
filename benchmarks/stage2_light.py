"""Light models of the Stage II fit beside each other: seconds per step, and error against seconds.

    python -m benchmarks.stage2_light graphs/samples/spot                 # precomputed beside Monte Carlo
    python -m benchmarks.stage2_light graphs/samples/spot --sweep         # settings of the precomputed light
    python -m benchmarks.stage2_light graphs/samples/spot --quick         # a minute: half size, few steps, one fit each

The true mesh, the quickstart's schedule. Steps are timed in turns (processor time of one thread, forward, backward and
Adam, the same views); fits are scored on views and lights that they never saw. Seconds of a fit hold what its light
traces first. --json writes all of it.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import torch
from exmesh_nodes import data, transport

from benchmarks.register import choosing
from benchmarks.stage2 import QUICK, Quiet, true_carrier
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.optim import Adam
from exmesh_graph.shading.settings import BounceSettings, MonteCarloSettings, TransportSettings
from exmesh_graph.stage2.decomposition import Decomposition
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.objective import weighted_terms
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.types import Carrier, Transport

#: name -> directions and points of the precomputed light, or settings of the sampled one.
LIGHTS: dict[str, tuple[int, int] | MonteCarloSettings] = {
    "precomputed": (128, 12_000),
    "Monte Carlo, paper (8, 16 x 4)": MonteCarloSettings(),
    "Monte Carlo, mis 64, 16 x 4": MonteCarloSettings(technique="mis", samples=64),
    "Monte Carlo, paper, 4 kept": MonteCarloSettings(kept=4),
}

#: What --sweep varies, one at a time: (directions, points, settings of the fit).
SWEEP: dict[str, tuple[int, int, dict[str, Any]]] = {
    "128 directions, 12 000 points, 2 corrections, sky 64 x 128": (128, 12_000, {}),
    "32 directions": (32, 12_000, {}),
    "64 directions": (64, 12_000, {}),
    "512 directions": (512, 12_000, {}),
    "3 000 points": (128, 3_000, {}),
    "8 000 points": (128, 8_000, {}),
    "40 000 points": (128, 40_000, {}),
    "no correction": (128, 12_000, {"corrections": 0}),
    "1 correction": (128, 12_000, {"corrections": 1}),
    "4 corrections": (128, 12_000, {"corrections": 4}),
    "corrections of 4 rays": (128, 12_000, {"correction_samples": 4}),
    "corrections of 8 rays": (128, 12_000, {"correction_samples": 8}),
    "sky 32 x 64": (128, 12_000, {"environment_height": 32}),
    "sky 128 x 256": (128, 12_000, {"environment_height": 128}),
}


def main() -> None:
    options = arguments()
    if options.sweep:
        choosing(options.scene)
    torch.set_num_threads(1)
    ctx = Quiet(options.seed)
    scene = data.blender(ctx, p=data.BlenderParams(path=options.scene, downscale=2 if options.quick else 1))
    carrier = true_carrier(ctx, scene)
    result: dict[str, Any] = {"scene": str(options.scene), "views": len(scene.train), "fits": []}
    if not options.sweep and not options.only:
        result["steps"] = step_times(ctx, carrier, scene, rounds=2 if options.quick else 8)
        write(options, result)
    jobs: list[tuple[str, Any, DecompositionSettings]] = []
    if options.sweep:
        for name, (directions, points, changes) in SWEEP.items():
            jobs.append((name, (directions, points), QUICK.replaced(iterations=400, **changes)))
    else:
        lengths = [40] if options.quick else options.iterations
        jobs = [(name, light, QUICK.replaced(iterations=n)) for n in lengths for name, light in LIGHTS.items()]
    if options.only:
        jobs = [job for job in jobs if any(word in job[0] for word in options.only)]
    print(f"{'light':60} steps  seconds   held-out   relit  albedo  roughness MSE")
    for name, light, settings in jobs:
        row = fitted(ctx, carrier, scene, light, settings)
        result["fits"].append({"light": name, **row})
        s = row["scores"]
        print(
            f"{name:60} {settings.iterations:5d} {row['seconds']:8.1f} {s['held_out']:10.2f} {s['relit']:7.2f} "
            f"{s['albedo']:7.2f}  {s['roughness']:.4f}",
            flush=True,
        )
        write(options, result)


def step_times(ctx: Quiet, carrier: Carrier, scene: data.BlenderOut, rounds: int, steps: int = 5) -> dict[str, float]:
    """Milliseconds of processor time per step of each light model, the least of `rounds` rounds taken in turns."""
    settings = QUICK.replaced(texture_size=512)
    runners = {}
    for name, light in LIGHTS.items():
        model = Decomposition(carrier, scene.train, made(ctx, carrier, light), settings, "cpu")
        model.start()
        model.measure(1.0, torch.Generator().manual_seed(0))
        runners[name] = (model, Adam([model.maps.parameter, model.environment], [1e-3, 1e-3]))
    least: dict[str, float] = {}
    for number in range(rounds + 1):
        for name, (model, optimiser) in runners.items():
            began = time.process_time()
            for step in range(number * steps, (number + 1) * steps):
                terms, _ = weighted_terms(
                    model, model.buffers[step % len(model.buffers)], settings.indirect_ramp + step
                )
                torch.stack(list(terms.values())).sum().backward()
                optimiser.step()
            spent = (time.process_time() - began) / steps * 1e3
            if number:  # the first round fills caches
                least[name] = min(spent, least.get(name, spent))
    base = least["precomputed"]
    pixels = sum(runners["precomputed"][0].buffers.pixels) / len(scene.train)
    print(f"a step of one view ({pixels:.0f} pixels), forward, backward and Adam; processor milliseconds, one thread")
    for name, spent in least.items():
        print(f"  {name:40} {spent:7.1f}   {spent / base:5.1f} x precomputed")
    return least


def made(ctx: Quiet, carrier: Carrier, light: tuple[int, int] | MonteCarloSettings) -> Transport | MonteCarloSettings:
    if isinstance(light, MonteCarloSettings):
        return light
    directions, points = light
    traced = transport.direct(ctx, carrier, p=TransportSettings(directions=directions, points=points)).transport
    return transport.bounce(ctx, traced, p=BounceSettings()).transport


def fitted(
    ctx: Quiet,
    carrier: Carrier,
    scene: data.BlenderOut,
    light: tuple[int, int] | MonteCarloSettings,
    settings: DecompositionSettings,
) -> dict[str, Any]:
    """One fit: processor seconds with whatever its light traces first, scores, and the loss along the way."""
    began = time.process_time()
    asset, curves = fit(
        carrier,
        scene.train,
        made(ctx, carrier, light),
        settings,
        seed=ctx.seed,
        start=neutral_asset(carrier, StartSettings(base_color="gray")),
    )
    seconds = time.process_time() - began
    scores = score_asset(asset, scene.test, scene.truth, scene.train).values
    figures = {key: headline(scores, key) for key in ("held_out", "relit", "albedo", "roughness")}
    return {"iterations": settings.iterations, "seconds": seconds, "scores": figures, "curves": curves}


def headline(scores: dict[str, Any], key: str) -> float:
    """A figure of evaluate.asset's headline by a word of its label."""
    word = {"held_out": "held", "relit": "relit", "albedo": "albedo", "roughness": "roughness"}[key]
    return next(float(h["value"]) for h in scores["headline"] if h["label"].lower().startswith(word))


def write(options: argparse.Namespace, result: dict[str, Any]) -> None:
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--sweep", action="store_true", help="settings of the precomputed light instead")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", metavar="WORD", help="only fits whose name holds a word; time no steps")
    parser.add_argument("--iterations", type=int, nargs="+", default=[50, 100, 200, 400])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
