"""Direct and one-bounce light, forward and backward, beside Mitsuba 3's path replay backpropagation at equal error.

    python -m benchmarks.light_prb            # some minutes
    python -m benchmarks.light_prb --quick

Both render the same pixels (rays through their centres) of the same scene under the same sky and differentiate sum(w
I), w random, to the vertices' base colour and roughness and to the sky's texels. Two materials: "matt", where both
integrals are the same and are held against one reference; "glossy", where Mitsuba's second bounce has its specular
lobe and ours has none, and each is held against its own converged reference. Every method runs in a process of its
own: best time of --repeats, errors relative (RMSE over RMS) of image and base-colour gradient, mean over the runs,
peak memory over what was in use before the first step.

Last columns: seconds over those of Mitsuba at the same error of image and of gradient (its error falls as a power
of its samples, its seconds grow linearly; both fitted to its runs). Mitsuba draws its gradient's
samples apart from the image's; ours share them unless the row says otherwise. "transport" is no Monte Carlo: it is
`shading.transport`, traced once, seconds of a step; its error is bias.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks import light_mitsuba, light_scene
from benchmarks.gradient_seed import independent_gradient
from exmesh_graph.shading import brdf
from exmesh_graph.shading.env_sampling import EnvSampler
from exmesh_graph.shading.gather import gather_rows
from exmesh_graph.shading.lattice import locate
from exmesh_graph.shading.monte_carlo import Drawn, Material, MonteCarloLight, SampleCache
from exmesh_graph.shading.operators import LightTransport
from exmesh_graph.shading.settings import MonteCarloSettings
from exmesh_graph.shading.transport import trace_transport, with_bounces

PAPER, DENSE = MonteCarloSettings(), MonteCarloSettings(technique="mis", samples=64)

#: name -> settings, half resolution, cached slots (-1: none, and the backward pass draws its own samples)
OURS: dict[str, tuple[MonteCarloSettings, bool, int]] = {
    "paper (environment 8, 16 x 4, half)": (PAPER, True, 0),
    "mis 64, 32 x 4, half": (DENSE.replaced(secondary_rays=32), True, 0),
    "environment 32, 16 x 4, half": (PAPER.replaced(samples=32), True, 0),
    "mis 64, 16 x 4, half": (DENSE, True, 0),
    "mis 32, 16 x 4, half": (DENSE.replaced(samples=32), True, 0),
    "mis 64, the gradient's own seed": (DENSE, True, -1),
    "paper, cached rays": (PAPER, True, 4),
    "mis 64, cached rays": (DENSE, True, 4),
}
SAMPLES = (4, 16, 64)

#: One step: (seed) -> image [N, 3], gradient to base colour [V, 3].
Step = Callable[[int], tuple[np.ndarray, np.ndarray]]


def main() -> None:
    options = arguments()
    if options.child:
        print(json.dumps(child(options)))
        return
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for surface in options.materials:
            names = [f"mitsuba {n}" for n in SAMPLES] + list(OURS) + (["transport"] if surface == "matt" else [])
            run(options, surface, "ours reference", folder)
            if surface == "glossy":
                run(options, surface, "mitsuba reference", folder)
            for name in names:
                rows.append({"material": surface, "name": name, **run(options, surface, name, folder)})
            compare([row for row in rows if row["material"] == surface])
    heads = ("method", "ms", "image", "gradient", "peak MiB", "/ Mitsuba", "by gradient")
    for surface in options.materials:
        print(f"\n{surface}: {rows[0]['points']} points, {options.threads} threads, {options.clock} clock")
        print(heads[0].ljust(38) + "".join(head.rjust(13) for head in heads[1:]))
        for row in (row for row in rows if row["material"] == surface):
            print(
                f"{row['name']:38}{1000 * row['seconds']:13.1f}{row['image']:13.2%}{row['gradient']:13.2%}"
                f"{row['peak_mib']:13.0f}{row['ratio']:13.2f}{row['ratio_gradient']:13.2f}"
            )
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def compare(rows: list[dict]) -> None:
    """Add each row's seconds over Mitsuba's at the same error, in place."""
    theirs = [row for row in rows if row["name"].startswith("mitsuba")]
    count = np.array([float(row["name"].split()[1]) for row in theirs])
    slope, fixed = np.polyfit(count, [row["seconds"] for row in theirs], 1, w=1 / count)
    for figure, name in (("image", "ratio"), ("gradient", "ratio_gradient")):
        power, start = np.polyfit(np.log(count), np.log([row[figure] for row in theirs]), 1)
        for row in rows:
            needed = np.exp((np.log(row[figure]) - start) / power)
            row[name] = float(row["seconds"] / (max(fixed, 0) + slope * needed))


def run(options: argparse.Namespace, surface: str, name: str, folder: str) -> dict:
    command = [sys.executable, "-m", "benchmarks.light_prb", "--child", name, "--materials", surface, "--work", folder]
    for key in ("size", "threads", "repeats", "runs", "reference", "clock", "sampler"):
        command += [f"--{key}", str(getattr(options, key))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stderr}")
    found = json.loads(done.stdout.splitlines()[-1])
    print(f"  {surface}, {name}: {found.get('seconds', 0) * 1000:.0f} ms", file=sys.stderr, flush=True)
    return found


def child(options: argparse.Namespace) -> dict:
    torch.set_num_threads(1)  # tensors of a step are small; rays and Mitsuba take all threads
    name, surface = options.child, options.materials[0]
    scene = light_scene.build(options.size)
    matt = surface == "matt"
    weights = torch.rand(len(scene.pixel), 3, generator=torch.Generator().manual_seed(0))
    store = Path(options.work)
    if name.endswith("reference"):
        if name.startswith("ours"):
            step = our_step(
                scene,
                options.threads,
                matt,
                weights,
                DENSE.replaced(secondary_rays=32),
                False,
                0,
            )
        else:
            step = mitsuba_step(scene, options.threads, matt, weights, 128, "independent")
        parts = [step(seed) for seed in range(1000, 1000 + options.reference)]
        image, gradient = (np.mean(values, axis=0) for values in zip(*parts, strict=True))
        np.savez(store / f"{surface}_{name.split()[0]}.npz", image=image, gradient=gradient)
        return {}
    if name == "transport":
        step = transport_step(scene, weights)
    elif name.startswith("mitsuba"):
        step = mitsuba_step(scene, options.threads, matt, weights, int(name.split()[1]), options.sampler)
    else:
        step = our_step(scene, options.threads, matt, weights, *OURS[name])
    before = resident()
    for seed in range(4 if "cached" in name else 1):
        step(seed)  # compile; fill the cache
    clock = time.process_time if options.clock == "cpu" else time.perf_counter
    seconds, runs = [], []
    for seed in range(max(options.repeats, options.runs)):
        began = clock()
        found = step(seed)
        seconds.append(clock() - began)
        runs.append(found)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before
    side = "mitsuba" if name.startswith("mitsuba") and not matt else "ours"
    with np.load(store / f"{surface}_{side}.npz") as reference:
        errors = [
            [relative(found, reference[key]) for found, key in zip(run, ("image", "gradient"), strict=True)]
            for run in runs[: options.runs]
        ]
    image, gradient = np.sqrt(np.mean(np.square(errors), axis=0))
    return {
        "seconds": min(seconds),
        "image": float(image),
        "gradient": float(gradient),
        "peak_mib": peak,
        "points": len(scene.pixel),
    }


def our_step(
    scene: light_scene.Scene,
    threads: int,
    matt: bool,
    weights: torch.Tensor,
    settings: MonteCarloSettings,
    half: bool,
    slots: int,
) -> Step:
    light = MonteCarloLight(scene.surface, scene.tracer(threads), settings)
    points, coarse = scene.points(), scene.coarse() if half else None
    attributes, sky = scene.attributes.clone().requires_grad_(), scene.sky.clone().requires_grad_()
    cache = SampleCache(slots) if slots > 0 else None

    def render(seed: int, attributes: torch.Tensor, sky: torch.Tensor) -> torch.Tensor:
        def read(face: torch.Tensor, bary: torch.Tensor) -> Material:
            material = scene.material(attributes, face, bary)
            return Material(material.base_color) if matt else material

        def query(face: torch.Tensor, bary: torch.Tensor) -> tuple[torch.Tensor, Material]:
            return scene.surface.face_normals[face], read(face, bary)

        def draw(number: int) -> Drawn:
            return light.draw(points, material, query, EnvSampler(sky), number, coarse)

        material = read(scene.face, scene.bary)
        drawn = cache.get(seed, draw) if cache else draw(seed)
        return light.shade(drawn, points, material, query, sky)

    def step(seed: int) -> tuple[np.ndarray, np.ndarray]:
        attributes.grad = sky.grad = None
        if slots < 0:
            image = independent_gradient(render, 2 * seed, 2 * seed + 1, attributes, sky)
        else:
            image = render(seed, attributes, sky)
        (image * weights).sum().backward()
        return image.detach().numpy(), attributes.grad[:, :3].numpy().copy()

    return step


def transport_step(scene: light_scene.Scene, weights: torch.Tensor) -> Step:
    """`shading.transport` with 256 directions at about 24 000 points; tracing is not in the step."""
    traced = with_bounces(trace_transport(scene.vertices, scene.faces, 256, 2), 1)
    operators = LightTransport(traced)
    binning = operators.bin_matrix(*scene.sky.shape[:2])
    carried_face = torch.from_numpy(traced.point_face.astype(np.int64))
    carried_bary = torch.from_numpy(traced.point_bary)
    index, weight = locate(traced, scene.face.numpy(), scene.bary.numpy())
    rows, shares = torch.from_numpy(index.astype(np.int64)), torch.from_numpy(weight)
    attributes, sky = scene.attributes.clone().requires_grad_(), scene.sky.clone().requires_grad_()

    def step(seed: int) -> tuple[np.ndarray, np.ndarray]:
        attributes.grad = sky.grad = None
        there = brdf.diffuse(scene.material(attributes, carried_face, carried_bary).base_color)
        irradiance = operators.irradiance(torch.sparse.mm(binning, sky.reshape(-1, 3)), there)
        here = brdf.diffuse(scene.material(attributes, scene.face, scene.bary).base_color)
        image = here * gather_rows(irradiance, rows, shares)
        (image * weights).sum().backward()
        return image.detach().numpy(), attributes.grad[:, :3].numpy().copy()

    return step


def mitsuba_step(
    scene: light_scene.Scene, threads: int, matt: bool, weights: torch.Tensor, samples: int, sampler: str
) -> Step:
    mi = light_mitsuba.load(threads)
    import drjit as dr

    loaded = light_mitsuba.scene_of(
        mi, scene, spp=samples, depth=3, specular=not matt, integrator="prb_centre", sampler=sampler
    )
    parameters = mi.traverse(loaded)
    names = [key for key in parameters.keys() if key.endswith(("vertex_base", "vertex_roughness", "sky.data"))]  # noqa: SIM118
    parameters.keep(names)
    base = next(name for name in names if name.endswith("vertex_base"))
    spread = np.zeros((scene.size**2, 3), np.float32)
    spread[scene.pixel.numpy()] = weights.numpy()
    upstream = mi.TensorXf(spread.reshape(scene.size, scene.size, 3))

    def step(seed: int) -> tuple[np.ndarray, np.ndarray]:
        for name in names:
            dr.enable_grad(parameters[name])
        parameters.update()
        image = mi.render(loaded, parameters, spp=samples, seed=2 * seed, seed_grad=2 * seed + 1)
        dr.backward(dr.sum(image[..., :3] * upstream, axis=None))
        gradients = [dr.grad(parameters[name]) for name in names]
        dr.eval(image, gradients)
        dr.sync_thread()
        gradient = np.array(gradients[names.index(base)]).reshape(-1, 3)
        for name in names:
            dr.disable_grad(parameters[name])
        return np.array(image)[..., :3].reshape(-1, 3)[scene.pixel.numpy()], gradient

    return step


def relative(found: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(((found - reference) ** 2).mean() / (reference**2).mean()))


def resident() -> float:
    """MiB in use by this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.light_prb", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=160, help="pixels on a side")
    parser.add_argument("--threads", type=int, default=2, help="cores for both")
    parser.add_argument(
        "--clock", choices=["wall", "cpu"], default="wall", help="cpu: seconds over all cores, for a busy machine"
    )
    parser.add_argument("--sampler", default="multijitter", help="Mitsuba's: independent, stratified, multijitter...")
    parser.add_argument("--repeats", type=int, default=8, help="steps to take the best time of")
    parser.add_argument("--runs", type=int, default=4, help="steps whose errors are averaged")
    parser.add_argument("--reference", type=int, default=64, help="steps averaged into the reference")
    parser.add_argument("--materials", nargs="+", choices=["matt", "glossy"], default=["matt", "glossy"])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, help="write the table as JSON")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.quick:
        options.size, options.repeats, options.runs, options.reference = 64, 3, 2, 8
    return options


if __name__ == "__main__":
    main()
