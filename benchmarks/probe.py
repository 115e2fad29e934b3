"""Is `auto` ever wrong? Stage II with what scene.probe chose, beside everything switched on and everything off.

    python -m benchmarks.probe graphs/samples/spot path/to/concave --middlebury path/to/temple_ring
    python -m benchmarks.probe --quick graphs/samples/spot              # half-size pictures, half the steps, two views
    python -m benchmarks.probe --decide graphs/samples/spot             # the decisions alone, seconds a scene

Scenes in the NeRF-Synthetic layout with their true mesh (or its visual hull where there is none), real photographs with
their visual hull, and three small ones made here: a matte ball, a metal ball and an open box. One line per scene and
choice: seconds (wall clock, processor) of transport, probe and fit, scores, and by how much `auto` stays below
everything on. The schedule is that of graphs/quickstart.yaml. --decide prints what the probe finds and fits nothing; it
adds balls of metal, pictures of noise and of one gray, and a scene of one view. --json writes the same with the
decisions.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from exmesh_nodes import data, init, stage1, uv

from benchmarks.stage2 import QUICK, Quiet, true_carrier
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.transport import direct_transport, with_bounces
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.probe.scene import probe_scene
from exmesh_graph.stage2.settings import StartSettings
from exmesh_graph.types import Carrier, SceneTruth, Views
from tests.stage2 import probe_scenes

ON = {"bounces": 2, "metallic": True, "environment_height": 128, "texture_size": 512}
OFF = {"bounces": 0, "metallic": False, "environment_height": 32, "texture_size": 256}
#: The scores in which `auto` must not fall below everything on.
SCORES = ("Held-out PSNR", "Relit PSNR", "Albedo PSNR (linear)")


def main() -> None:
    options = arguments()
    torch.set_num_threads(options.threads)
    results = []
    for name, carrier, train, test, truth in scenes(options):
        result = (
            decide(name, carrier, train, options)
            if options.decide
            else compare(name, carrier, train, test, truth, options)
        )
        results.append(result)
        if options.json:
            options.json.write_text(json.dumps(results, indent=1) + "\n")
    if options.decide:
        return
    worst = max((gap for result in results for gap in result["below_everything_on"].values()), default=0.0)
    print(f"auto is at most {worst:.2f} dB below everything on, over {len(results)} scenes")


def decide(name: str, carrier: Carrier, train: Views, options: argparse.Namespace) -> dict[str, Any]:
    """The probe's decisions on one scene."""
    clock = Clock()
    needs = probe_scene(carrier, train, seed=options.seed).needs
    seconds = clock.lap()
    print(f"{name}: concavity {needs.geometry['concavity']:.3f}, {seconds[1]:.1f} s busy")
    for key, decision in needs.decisions.items():
        gain = "" if decision.gain is None else f"  {decision.gain:+.2f} dB"
        gain += "" if decision.error is None else f" ± {decision.error:.2f}"
        print(f"    {key}: {decision.value}{gain}. {decision.reason}", flush=True)
    decisions = {key: vars(decision) for key, decision in needs.decisions.items()}
    return {"scene": name, "decisions": decisions, "geometry": dict(needs.geometry), "probe_seconds": seconds}


def compare(
    name: str, carrier: Carrier, train: Views, test: Views, truth: SceneTruth | None, options: argparse.Namespace
) -> dict[str, Any]:
    """Probe and the three fits of one scene."""
    print(f"{name}: {len(carrier.vertices)} vertices, {len(train)} training views", flush=True)
    clock = Clock()
    probed = probe_scene(carrier, train, seed=options.seed)
    probe_seconds = clock.lap()
    for key, decision in probed.needs.decisions.items():
        print(f"    {key}: {decision.value}. {decision.reason}")
    chosen = {key: decision.value for key, decision in probed.needs.decisions.items()}
    rows: dict[str, Any] = {}
    for mode, choice in (("auto", chosen), ("on", ON), ("off", OFF)):
        choice = {key: choice[key] for key in ON}
        if choice in [row["choice"] for row in rows.values()]:
            rows[mode] = next(row for row in rows.values() if row["choice"] == choice)
            continue
        clock = Clock()
        light = direct_transport(carrier.vertices, carrier.faces, TransportSettings())
        light = with_bounces(light, choice["bounces"]) if choice["bounces"] else light
        settings = replace(
            QUICK,
            iterations=options.iterations,
            metallic=choice["metallic"],
            environment_height=choice["environment_height"],
            texture_size=choice["texture_size"],
        )
        asset, _ = fit(
            carrier,
            train,
            light,
            settings,
            seed=options.seed,
            start=neutral_asset(carrier, StartSettings(base_color="gray")),
        )
        seconds = clock.lap()
        if mode == "auto":
            seconds = tuple(a + b for a, b in zip(seconds, probe_seconds, strict=True))
        scored = score_asset(asset, test, truth, train, max_views=options.views).values["headline"]
        scores = {h["label"]: h["value"] for h in scored}
        rows[mode] = {"choice": choice, "seconds": seconds, "scores": scores}
        shown = "  ".join(
            f"{label} {value:.4g}" for label, value in scores.items() if label != "Relit PSNR, albedo unscaled"
        )
        print(f"  {mode:5s} {seconds[0]:6.1f} s ({seconds[1]:.1f} busy)  {shown}", flush=True)
    on, auto = rows["on"]["scores"], rows["auto"]["scores"]
    below = {label: on[label] - auto[label] for label in SCORES if label in on}
    print("  auto below everything on: " + "  ".join(f"{k} {v:+.2f} dB" for k, v in below.items()), flush=True)
    decisions = {key: vars(decision) for key, decision in probed.needs.decisions.items()}
    return {
        "scene": name, "rows": rows, "below_everything_on": below, "decisions": decisions,
        "geometry": dict(probed.needs.geometry), "probe_seconds": probe_seconds,
    }  # fmt: skip


class Clock:
    """Seconds since it was made: (wall clock, processor)."""

    def __init__(self) -> None:
        self.began = time.perf_counter(), time.process_time()

    def lap(self) -> tuple[float, ...]:
        return time.perf_counter() - self.began[0], time.process_time() - self.began[1]


def scenes(options: argparse.Namespace):  # type: ignore[no-untyped-def]
    """(name, carrier, training views, test views, truth or None) of everything asked for."""
    ctx = Quiet(options.seed)
    for path in options.scenes:
        found = data.blender(ctx, p=data.BlenderParams(path=path, downscale=options.downscale))
        known = found.truth is not None and found.truth.mesh_vertices is not None
        carrier = true_carrier(ctx, found) if known else hull_carrier(ctx, found.train)
        yield path.name, carrier, found.train, found.test, found.truth
    for path in options.middlebury:
        params = data.MiddleburyParams(path=path, holdout=8, downscale=2 * options.downscale)
        found = data.middlebury(ctx, p=params)
        yield path.name, hull_carrier(ctx, found.train, wrong_masks=1), found.train, found.test, None
    if options.decide and not options.no_own:
        for name, carrier, train in odd_scenes():
            yield name, carrier, train, train, None
    elif not options.no_own:
        for name, shape, metallic, above in (
            ("matte ball", probe_scenes.ball(), None, False),
            ("metal ball", probe_scenes.ball(), 1.0, False),
            ("open box", probe_scenes.box(), None, True),
        ):
            truth = probe_scenes.asset(shape, metallic=metallic, roughness=0.4)
            views = probe_scenes.photographed(truth, 20, above=above)
            rows = np.arange(20) % 5 == 2
            yield name, probe_scenes.carrier_of(truth), part(views, ~rows, "train"), part(views, rows, "test"), None


def odd_scenes():  # type: ignore[no-untyped-def]
    """(name, carrier, training views) of balls, and of pictures that show nothing of the mesh."""
    shapes = {"ball": probe_scenes.ball(), "box": probe_scenes.box()}
    matte = probe_scenes.asset(shapes["ball"])
    views = probe_scenes.photographed(matte)
    noise, gray = np.random.default_rng(5).random(views.images.shape), np.full(views.images.shape, 0.4)
    yield "matte ball", probe_scenes.carrier_of(matte), views
    for roughness in (0.3, 0.5):
        metal = probe_scenes.asset(shapes["ball"], metallic=1.0, roughness=roughness)
        yield f"metal ball, roughness {roughness}", probe_scenes.carrier_of(metal), probe_scenes.photographed(metal)
    for name, images in (("noise", noise), ("one gray", gray)):
        shown = replace(views, images=(images * views.alpha[..., None]).astype(np.float32))
        yield f"ball, pictures of {name}", probe_scenes.carrier_of(matte), shown
    yield "ball, one view", probe_scenes.carrier_of(matte), probe_scenes.photographed(matte, 1)
    hollow = probe_scenes.asset(shapes["box"])
    views = probe_scenes.photographed(hollow, above=True)
    noise = np.random.default_rng(5).random(views.images.shape) * views.alpha[..., None]
    yield (
        "open box, pictures of noise",
        probe_scenes.carrier_of(hollow),
        replace(views, images=noise.astype(np.float32)),
    )


def hull_carrier(ctx: Quiet, train: Views, wrong_masks: int = 0) -> Carrier:
    """The visual hull, unwrapped and coloured: a coarse carrier where no true mesh is known."""
    hull = init.visual_hull(ctx, train, p=init.HullSettings(resolution=96, wrong_masks=wrong_masks)).mesh
    coarse = init.clean(ctx, hull, p=init.CleanSettings(faces=5000)).mesh
    atlas = uv.unwrap(ctx, coarse, p=uv.UnwrapParams(texture_size=512)).carrier
    return stage1.init(ctx, atlas, train, p=stage1.InitParams()).state


def part(views: Views, rows: np.ndarray, split: str) -> Views:
    """Some of the views."""
    return replace(
        views,
        names=tuple(np.array(views.names)[rows].tolist()),
        images=views.images[rows],
        alpha=views.alpha[rows],
        intrinsics=views.intrinsics[rows],
        camera_to_world=views.camera_to_world[rows],
        split=split,
    )


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="*", help="folders in the NeRF-Synthetic layout")
    parser.add_argument("--middlebury", type=Path, nargs="*", default=[], help="folders of Middlebury sets")
    parser.add_argument("--decide", action="store_true", help="print the probe's decisions and fit nothing")
    parser.add_argument("--no-own", action="store_true", help="leave the scenes made here out")
    parser.add_argument("--quick", action="store_true", help="half-size pictures, 200 steps, two scored views")
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--downscale", type=int, default=1)
    parser.add_argument("--views", type=int, default=0, help="score so many test views; 0 = all")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.iterations, options.downscale, options.views = 200, 2, 2
    return options


if __name__ == "__main__":
    main()
