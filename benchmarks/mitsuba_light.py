"""Our Monte Carlo light against Mitsuba 3's path tracer at exactly the same surface points, with the same BRDF and
sky.

    python -m benchmarks.mitsuba_light            # about two minutes on two cores
    python -m benchmarks.mitsuba_light --quick

direct        eq. 12 with the whole BRDF                 Mitsuba: path, depth 2
direct, diffuse                                          the same with (1 - m) a / pi alone
bounce        eq. 19, diffuse on diffuse                 Mitsuba: path, depth 3 minus depth 2, diffuse BRDF
one bounce    direct + bounce                            sum of the two

Relative RMSE is over the image, both sides' own noise included (`noise`: what it alone would give, from the spread of
batches); z = difference / standard error per pixel and channel: mean 0 and deviation 1 say that nothing but noise is
left. Exits with 1 where the error of an image passes --limit.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import torch

from benchmarks import light_mitsuba, light_scene
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.monte_carlo import Material, MonteCarloLight, shade
from exmesh_graph.shading.monte_carlo.bounce import bounce_irradiance
from exmesh_graph.shading.settings import MonteCarloSettings


def main() -> int:
    options = arguments()
    torch.set_num_threads(options.threads)
    scene = light_scene.build(options.size, metallic=True)
    mi = light_mitsuba.load(options.threads)
    print(f"{len(scene.pixel)} points, {len(scene.faces)} faces, {options.batches} batches", flush=True)
    ours = our_batches(scene, options)
    theirs = mitsuba_batches(mi, scene, options)
    rows = [compare(name, ours[name], theirs[name]) for name in theirs]
    heads = ("", "rel. RMSE", "noise", "mean diff.", "pixel median", "pixel 95 %", "z mean", "z std", "|z| 95 %")
    print("  ".join(head.rjust(12) if head else " " * 16 for head in heads))
    for row in rows:
        print(row["name"].ljust(16) + "  " + "  ".join(f"{v:12.4f}" for k, v in row.items() if k != "name"))
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    # the bounce alone is a difference of two of Mitsuba's images: what is left of it is their noise
    worst = max(row["relative_rmse"] for row in rows if row["name"] != "bounce")
    print(f"worst relative RMSE {worst:.2%}, limit {options.limit:.2%}")
    return int(worst > options.limit)


def our_batches(scene: light_scene.Scene, options: argparse.Namespace) -> dict[str, np.ndarray]:
    """Batches [B, N, 3] of each quantity, by the default estimator at high sample counts."""
    points, query = scene.points(), scene.query(scene.attributes)
    material = scene.material(scene.attributes, scene.face, scene.bary)
    matt = Material(material.diffuse())
    settings = MonteCarloSettings(
        technique="mis", samples=options.direct_samples, secondary_rays=options.secondary_rays, secondary_samples=4
    )
    light = MonteCarloLight(scene.surface, scene.tracer(options.threads), settings)
    sampler = EnvSampler(scene.sky)
    found: dict[str, list[np.ndarray]] = {"direct": [], "direct, diffuse": [], "bounce": []}
    for seed in range(options.batches):
        drawn = light.draw(points, material, query, sampler, seed)
        assert drawn.hits is not None
        arrived = bounce_irradiance(drawn.hits, points, query, scene.sky)
        found["direct"].append(shade(drawn.direct, points.normal, points.view, material, scene.sky).numpy())
        found["direct, diffuse"].append(shade(drawn.direct, points.normal, points.view, matt, scene.sky).numpy())
        found["bounce"].append((material.diffuse() / np.pi * arrived).numpy())
    batches = {name: np.stack(values) for name, values in found.items()}
    batches["one bounce"] = batches["direct"] + batches["bounce"]
    return batches


def mitsuba_batches(mi: object, scene: light_scene.Scene, options: argparse.Namespace) -> dict[str, np.ndarray]:
    """The same by Mitsuba. Depth 2 and 3 share their seeds: the paths' first halves cancel in the difference."""
    plans = {"direct": (2, True), "matt 2": (2, False), "matt 3": (3, False)}
    found = {}
    for name, (depth, specular) in plans.items():
        loaded = light_mitsuba.scene_of(mi, scene, spp=options.spp, depth=depth, specular=specular)
        runs = []
        for batch in range(options.batches):
            parts = [
                light_mitsuba.radiance(mi, loaded, scene, options.spp, 100 * batch + part)
                for part in range(options.parts)
            ]
            runs.append(np.mean(parts, axis=0))
        found[name] = np.stack(runs)
    bounce = found["matt 3"] - found["matt 2"]
    return {
        "direct": found["direct"],
        "direct, diffuse": found["matt 2"],
        "bounce": bounce,
        "one bounce": found["direct"] + bounce,
    }


def compare(name: str, ours: np.ndarray, theirs: np.ndarray) -> dict[str, float | str]:
    """Figures of batches [B, N, 3] against batches [B, N, 3]."""
    a, b = ours.mean(0), theirs.mean(0)
    error2 = ours.var(0, ddof=1) / len(ours) + theirs.var(0, ddof=1) / len(theirs)
    scale = float(np.sqrt((b**2).mean()))
    z = (a - b) / np.sqrt(np.maximum(error2, 1e-30))
    pixel = np.abs(a - b).sum(1) / b.sum(1)
    return {
        "name": name,
        "relative_rmse": float(np.sqrt(((a - b) ** 2).mean())) / scale,
        "noise": float(np.sqrt(error2.mean())) / scale,
        "mean_difference": float(a.mean() / b.mean() - 1),
        "pixel_median": float(np.median(pixel)),
        "pixel_95": float(np.quantile(pixel, 0.95)),
        "z_mean": float(z.mean()),
        "z_std": float(z.std()),
        "z_95": float(np.quantile(np.abs(z), 0.95)),
    }


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.mitsuba_light",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--size", type=int, default=40, help="pixels on a side")
    parser.add_argument("--batches", type=int, default=16)
    parser.add_argument("--spp", type=int, default=1024, help="Mitsuba paths a point in one launch")
    parser.add_argument("--parts", type=int, default=3, help="launches a batch")
    parser.add_argument("--direct-samples", type=int, default=1024)
    parser.add_argument("--secondary-rays", type=int, default=512)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--limit", type=float, default=0.01, help="exit with 1 beyond this relative RMSE")
    parser.add_argument("--quick", action="store_true", help="seconds; limit 10 %%")
    parser.add_argument("--out", type=Path, help="write the table as JSON")
    options = parser.parse_args()
    if options.quick:
        options.size, options.batches, options.spp, options.parts, options.limit = 24, 8, 256, 1, 0.1
        options.direct_samples, options.secondary_rays = 256, 128
    return options


if __name__ == "__main__":
    sys.exit(main())
