"""Stage II, error against seconds: transport and fit on a scene with known truth, scored on unseen views and lights.

    python -m benchmarks.stage2 graphs/samples/spot                          # the true mesh as carrier
    python -m benchmarks.stage2 graphs/samples/spot --carrier FOLDER         # a stored Stage1State or Carrier
    python -m benchmarks.stage2 graphs/samples/spot --set corrections=0 --set ssim_weight=0.2 --iterations 100 400
    python -m benchmarks.stage2 FOLDER/concave --bounces 0 1 3 --iterations 400       # what interreflection is worth
    python -m benchmarks.stage2 path/to/spot --choosing --iterations 500 --set material_rate=0.1    # choose settings

One line per number of bounces in the fit and of iterations: seconds (wall clock and processor) of transport and fit,
held-out and relit PSNR, albedo PSNR after the median scale, roughness MSE. Scored renders have two bounces. --out
writes the same as JSON; --quick is a short run on quarter-size pictures, whose figures mean nothing.

--choosing takes the full set that the sample was drawn from, to choose settings on views and lights that no score uses:
fitted to the sample's 40 training views in 8 bits, scored on ten of the 20 others (held-out) and on the four test views
that the sample lacks, under the full set's lights (relit, albedo).
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np
import torch
from exmesh_nodes import data, stage1, transport, uv

from benchmarks import register
from exmesh_graph.evaluate.asset import score_asset
from exmesh_graph.geometry.adjacency import angle_weighted_normals
from exmesh_graph.shading.settings import TransportSettings
from exmesh_graph.shading.transport import with_bounces
from exmesh_graph.stage2.fit import fit
from exmesh_graph.stage2.init import neutral_asset
from exmesh_graph.stage2.settings import DecompositionSettings, StartSettings
from exmesh_graph.types import Carrier, Mesh, Stage1State, Views

#: The quickstart's schedule: short, with the weights chosen in docs/stage2_trials.md.
QUICK = DecompositionSettings(
    texture_size=512,
    environment_height=64,
    iterations=400,
    material_rate=0.3,
    environment_rate=0.6,
    ssim_weight=0.0,
    material_weight=0.01,
    environment_weight=0.002,
    indirect_ramp=50,
    corrections=2,
    factor_rate=0.03,
    chroma_weight=0.0,
)


class Quiet:
    """The context that nodes ask for."""

    node, scratch = "benchmark", Path()

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def progress(self, step: int, total: int, **figures: float) -> None: ...
    def log(self, message: str) -> None: ...
    def warn(self, message: str) -> None:
        print("warning:", message)


def main() -> None:
    options = arguments()
    if options.choosing or options.set:
        register.choosing(options.scene)
    torch.set_num_threads(options.threads)
    ctx = Quiet(options.seed)
    if options.quick:
        options.iterations, options.downscale = [20], 4
    others = None
    if options.choosing:
        options.downscale, options.hdr = 2 * options.downscale, "false"
    given = data.BlenderParams(path=options.scene, downscale=options.downscale, hdr=options.hdr)
    scene = data.blender(ctx, p=given)
    if options.choosing:
        scene, others = choosing(scene)
    carrier = stored_carrier(options.carrier) if options.carrier else true_carrier(ctx, scene)
    print(f"{len(carrier.vertices)} vertices, {len(carrier.faces)} faces, {len(scene.train)} training views")
    began, busy = time.perf_counter(), time.process_time()
    light = transport.direct(ctx, carrier, p=TransportSettings(directions=options.directions)).transport
    traced = (time.perf_counter() - began, time.process_time() - busy)
    found = []
    start = neutral_asset(carrier, StartSettings(base_color=options.start))
    for bounces, iterations in itertools.product(options.bounces, options.iterations):
        settings = QUICK.replaced(**{**dict(options.set), "iterations": iterations})
        began, busy = time.perf_counter(), time.process_time()
        lit = with_bounces(light, bounces) if bounces else light
        asset, curves = fit(carrier, scene.train, lit, settings, seed=options.seed, start=start)
        seconds = (time.perf_counter() - began + traced[0], time.process_time() - busy + traced[1])
        scores = score_asset(asset, scene.test, scene.truth, scene.train).values
        if others is not None:
            scores["headline"][0] = score_asset(asset, others, None, scene.train).values["headline"][0]
        row = {
            "bounces": bounces,
            "iterations": iterations,
            "seconds": seconds[0],
            "processor_seconds": seconds[1],
            "transport_seconds": traced[0],
            "scores": scores,
            "curves": curves,
        }
        found.append(row)
        figures = "  ".join(f"{h['label']} {h['value']:.4g}" for h in scores["headline"])
        print(
            f"{bounces} bounces {iterations:6d} iterations  {seconds[0]:6.1f} s ({seconds[1]:.1f} busy)  {figures}",
            flush=True,
        )
        if options.out:
            options.out.mkdir(parents=True, exist_ok=True)
            (options.out / "stage2.json").write_text(json.dumps(found, indent=1) + "\n")
            asset_folder = options.out / f"asset_{bounces}_{iterations}"
            asset_folder.mkdir(exist_ok=True)
            asset.save(asset_folder)


def choosing(scene: data.BlenderOut) -> tuple[data.BlenderOut, Views]:
    """The full set cut like the sample (two of three views), tested where the sample does not look; held-out views."""
    train, test = np.arange(len(scene.train)), np.arange(len(scene.test))
    fitted, relit = scene.train.subset(train[train % 3 < 2]), scene.test.subset(test[test % 3 == 2])
    return scene._replace(train=fitted, test=relit), scene.train.subset(train[train % 6 == 2])


def true_carrier(ctx: Quiet, scene: data.BlenderOut) -> Carrier:
    """The scene's true mesh in an atlas of our own, coloured from the photographs.

    Vertices at one place are welded where the surface is smooth: their normals stand less than 40 degrees apart.
    """
    vertices, faces = scene.truth.mesh_vertices, scene.truth.mesh_faces
    _, place = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    normals = angle_weighted_normals(vertices, faces)
    first: dict[int, list[int]] = {}
    target = np.arange(len(vertices))
    for vertex, where in enumerate(place.reshape(-1)):
        known = first.setdefault(int(where), [])
        same = [k for k in known if normals[k] @ normals[vertex] > np.cos(np.radians(40))]
        target[vertex] = same[0] if same else vertex
        known += [] if same else [vertex]
    kept, faces = np.unique(target[faces], return_inverse=True)
    mesh = Mesh(vertices[kept].astype(np.float32), faces.reshape(-1, 3).astype(np.int32))
    atlas = uv.unwrap(ctx, mesh, p=uv.UnwrapParams(texture_size=512)).carrier
    return stage1.init(ctx, atlas, scene.train, p=stage1.InitParams()).state


def stored_carrier(folder: Path) -> Carrier:
    """A Carrier or Stage1State as the store keeps it, from the folder that holds its meta.json."""
    is_state = "iteration" in json.loads((folder / "meta.json").read_text())
    return (Stage1State if is_state else Carrier).load(folder)


def assignment(text: str) -> tuple[str, object]:
    name, _, value = text.partition("=")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--carrier", type=Path, help="folder of a stored Carrier or Stage1State")
    parser.add_argument("--iterations", type=int, nargs="+", default=[100, 200, 400, 800])
    parser.add_argument("--directions", type=int, default=128)
    parser.add_argument("--bounces", type=int, nargs="+", default=[1])
    parser.add_argument("--choosing", action="store_true", help="the scene is the sample's full set; see above")
    parser.add_argument("--hdr", choices=["auto", "true", "false"], default="auto")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--downscale", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--start", choices=["gray", "texture"], default="gray", help="where base colour starts")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", type=assignment, action="append", default=[], metavar="SETTING=VALUE")
    parser.add_argument("--out", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
