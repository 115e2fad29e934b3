"""Stage I, error against seconds and vertices: hull -> atlas -> rounds of refine, split (and merge, flip), scored after
every round.

    python -m benchmarks.stage1 graphs/samples/spot --json curves.json     # adaptive against uniform, same vertices
    python -m benchmarks.stage1 SCENE --methods score --hull-views 10 --faces 1250 --levels 1 --rounds 4
    python -m benchmarks.stage1 path/to/temple_ring --layout middlebury --downscale 2 --wrong-masks 1 --faces 5000 \
        --levels 1 --silhouette-weight 1 --smoothness-weight 0.1 --gains --methods score

Every method starts from the same hull, atlas and texture, takes the same iterations and ends at the same faces:
`uniform` splits all faces into four at the end of each level's share, the others double their faces twice as often,
finishing at the same iteration. Prints one line per round (seconds of Stage I so far, faces and vertices, Chamfer
distance in thousandths of the bounding radius, the same with each distance held at 5, median and 90th percentile of the
distances, held-out display PSNR, 1000 x mean |alpha - mask|, and how many faces cut others).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from exmesh_nodes import data, init, regulariser, stage1, topology, uv

from benchmarks.register import choosing
from exmesh_graph.evaluate.metrics.distance import distance_to_mesh
from exmesh_graph.evaluate.metrics.image import psnr
from exmesh_graph.evaluate.metrics.mesh import bounding_radius, count_self_intersections
from exmesh_graph.geometry.surface import sample_surface
from exmesh_graph.losses import display
from exmesh_graph.stage1.render import render_carrier


class Quiet:
    """The context the nodes ask for."""

    node, scratch = "benchmark", Path()

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def progress(self, step: int, total: int, **figures: float) -> None: ...
    def log(self, message: str) -> None: ...
    def checkpoint(self, step: int, state: object) -> None: ...
    def resume(self) -> None: ...
    def warn(self, message: str) -> None:
        print("warning:", message)


def main() -> None:
    options = arguments()
    choosing(options.scene)
    torch.set_num_threads(options.threads)
    ctx = Quiet(options.seed)
    if options.layout == "blender":
        scene = data.blender(ctx, p=data.BlenderParams(path=options.scene, downscale=options.downscale))
        truth = (scene.truth.mesh_vertices, scene.truth.mesh_faces)
    else:
        scene = data.middlebury(
            ctx, p=data.MiddleburyParams(path=options.scene, downscale=options.downscale, holdout=8)
        )
        truth = None
    began = time.perf_counter()
    masks = some(scene.train, options.hull_views) if options.hull_views else scene.train
    mesh = init.visual_hull(ctx, masks, p=init.HullSettings(resolution=96, wrong_masks=options.wrong_masks)).mesh
    mesh = init.clean(ctx, mesh, p=init.CleanSettings(faces=options.faces)).mesh
    if options.photometric:
        mesh = init.photometric(ctx, mesh, scene.train, p=init.PhotometricParams(passes=options.photometric)).mesh
    carrier = uv.unwrap(ctx, mesh, p=uv.UnwrapParams(texture_size=options.texels)).carrier
    hull_seconds = time.perf_counter() - began
    began = time.perf_counter()
    start = stage1.init(ctx, carrier, scene.train, p=stage1.InitParams(texture=options.start)).state
    seconds = time.perf_counter() - began
    print(f"hull, remesh, atlas {hull_seconds:.1f} s; texture from the views {seconds:.1f} s")
    curves = {}
    for method in options.methods:
        curves[method] = curve(method, start, scene, truth, seconds, options)
    if options.json:
        options.json.write_text(json.dumps(curves, indent=1) + "\n", encoding="utf-8")


def curve(method: str, state, scene, truth, seconds: float, options: argparse.Namespace) -> list[dict[str, float]]:
    """Figures after every round of one method."""
    print(method)
    rows = [{"seconds": seconds, **score(state, scene.test, truth)}]
    show(rows[-1])
    kinds = {
        "laplacian": regulariser.Laplacian,
        "bilaplacian": regulariser.Bilaplacian,
        "large_steps": regulariser.LargeSteps,
    }
    smooth, firm = (
        kinds[options.smoothness](**({} if options.smoothness == "large_steps" else {"weight": weight}))
        for weight in (options.smoothness_weight, options.firm_weight)
    )
    fixed = {
        key: getattr(options, key)
        for key in ("vertex_lr", "vertex_decay", "vertex_hold", "texture_lr", "texture_decay", "silhouette_weight",
                    "gains", "ssim_weight")
    } | {"uv_gradient": not options.no_uv_gradient, "threads": options.threads}  # fmt: skip
    first = len(state.faces)
    rounds = plan(method, first, options)
    for k, (target, iterations) in enumerate(rounds):
        ctx = Quiet(options.seed + k)
        began = time.perf_counter()
        if k:
            state = rearrange(ctx, method, state, target, scene.train)
            if options.untangle:
                state = topology.untangle(ctx, state, p=topology.UntangleSettings()).state
            if method != "uniform" and options.atlas_every and k % options.atlas_every == 0:
                state = uv.regenerate(ctx, state, p=uv.RegenerateParams()).state
        params = stage1.RefineParams(iterations=iterations, total_iterations=options.iterations, **fixed)
        term = firm if k + 1 == len(rounds) else smooth
        state, history = stage1.refine(ctx, state, scene.train, smoothness=term, p=params)
        if options.untangle and k + 1 == len(rounds):
            state = topology.untangle(ctx, state, p=topology.UntangleSettings()).state
        seconds += time.perf_counter() - began
        rows.append({"seconds": seconds, "train_psnr": history.values["psnr"][-1], **score(state, scene.test, truth)})
        show(rows[-1])
    if options.out:
        write(options.out / method, state, scene.test)
    return rows


def plan(method: str, faces: int, options: argparse.Namespace) -> list[tuple[int, int]]:
    """(faces to reach first, iterations) of every round; the last split comes after `split_until` of all iterations."""
    number = options.levels if method == "uniform" else options.rounds or 2 * options.levels
    each = round(options.split_until * options.iterations / max(number, 1))
    rounds = [(round(faces * 4 ** (options.levels * k / max(number, 1))), each) for k in range(number)]
    return [*rounds, (faces * 4**options.levels, options.iterations - number * each)]


def rearrange(ctx: Quiet, method: str, state, faces: int, views):
    """The topology step of the graphs; uniform splitting needs no merging and no flips."""
    if method == "uniform":
        return topology.split(
            ctx, state, p=topology.SplitParams(method="uniform", max_faces=4 * len(state.faces))
        ).state
    state = topology.split(ctx, state, p=topology.SplitParams(method=method, target_faces=faces)).state
    state = topology.merge(ctx, state, views, p=topology.MergeParams()).state
    return topology.flip(ctx, state, p=topology.FlipParams()).state


def some(views, count: int):
    """`count` of the views, evenly spread over their order."""
    index = np.linspace(0, len(views) - 1, count).round().astype(int)
    return views.subset(index)


def score(state, views, truth) -> dict[str, float]:
    colours, alphas = render_carrier(state, views)
    target = display(torch.from_numpy(views.images), torch.from_numpy(views.alpha)).numpy()
    found = {
        "faces": len(state.faces),
        "vertices": len(state.vertices),
        "psnr": float(np.mean([psnr(a, b) for a, b in zip(colours, target, strict=True)])),
        "alpha": 1000 * float(np.abs(alphas - views.alpha).mean()),
    }
    # what is left once each held-out view has its own exposure
    gain = (colours * target).sum((1, 2)) / np.maximum((colours**2).sum((1, 2)), 1e-9)
    exposed = np.clip(colours * gain[:, None, None], 0, 1)
    found["psnr_exposed"] = float(np.mean([psnr(a, b) for a, b in zip(exposed, target, strict=True)]))
    if truth is not None:
        found |= distances(state, *truth)
    found["cutting"] = count_self_intersections(state.vertices, state.faces)
    return found


def distances(state, vertices: np.ndarray, faces: np.ndarray, samples: int = 40_000) -> dict[str, float]:
    """Chamfer distance in thousandths of the radius; the same with each distance held at 5 (what is left when deep
    cavities count little); the median and the 90th percentile of all distances."""
    points = sample_surface(state.vertices, state.faces, samples, 0)[0], sample_surface(vertices, faces, samples, 1)[0]
    found = [distance_to_mesh(points[0], vertices, faces), distance_to_mesh(points[1], state.vertices, state.faces)]
    both = 1000 * np.concatenate(found) / bounding_radius(vertices)
    middle, high = np.percentile(both, (50, 90))
    held = np.minimum(both, 5).mean()
    return {"chamfer": float(both.mean()), "held_at_5": float(held), "median": float(middle), "p90": float(high)}


def show(row: dict[str, float]) -> None:
    print("  ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)


def write(folder: Path, state, views) -> None:
    from exmesh_graph.io.images import write_image

    folder.mkdir(parents=True, exist_ok=True)
    colours, _ = render_carrier(state, views)
    target = display(torch.from_numpy(views.images), torch.from_numpy(views.alpha)).numpy()
    for i in range(min(3, len(views))):
        pair = np.concatenate([colours[i], target[i], np.abs(colours[i] - target[i]) * 4], axis=1)
        write_image(folder / f"view{i}.png", np.clip(pair, 0, 1))
    write_image(folder / "texture.png", state.texture)
    state.save(folder)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--layout", choices=("blender", "middlebury"), default="blender")
    parser.add_argument("--downscale", type=int, default=1)
    parser.add_argument("--wrong-masks", type=int, default=0)
    parser.add_argument("--texels", type=int, default=256)
    parser.add_argument("--hull-views", type=int, default=0, help="views that the hull may use; 0 = all")
    parser.add_argument("--faces", type=int, default=2000, help="of the start")
    parser.add_argument("--levels", type=int, default=2, help="each makes four times as many faces")
    parser.add_argument("--rounds", type=int, default=0, help="of the adaptive methods; 0 = two for each level")
    parser.add_argument("--atlas-every", type=int, default=0, help="rounds of the adaptive methods; 0 = never anew")
    parser.add_argument("--photometric", type=int, default=0, help="passes of init.photometric on the coarse mesh")
    parser.add_argument("--iterations", type=int, default=3000)
    parser.add_argument("--split-until", type=float, default=0.53, help="share of the iterations before the last split")
    parser.add_argument("--methods", nargs="+", default=["uniform", "score"],
                        choices=("uniform", "score", "area", "random"))  # fmt: skip
    parser.add_argument("--start", choices=("views", "grey"), default="views")
    parser.add_argument("--vertex-lr", type=float, default=0.02)
    parser.add_argument("--vertex-decay", type=float, default=0.025)
    parser.add_argument("--vertex-hold", type=float, default=0.27)
    parser.add_argument("--texture-lr", type=float, default=0.02)
    parser.add_argument("--texture-decay", type=float, default=0.05)
    parser.add_argument("--ssim-weight", type=float, default=0.2)
    parser.add_argument("--smoothness", choices=("laplacian", "bilaplacian", "large_steps"), default="bilaplacian")
    parser.add_argument("--smoothness-weight", type=float, default=0.3)
    parser.add_argument("--firm-weight", type=float, default=2.0, help="of smoothness after the last split")
    parser.add_argument("--silhouette-weight", type=float, default=5.0)
    parser.add_argument("--no-uv-gradient", action="store_true")
    parser.add_argument("--gains", action="store_true")
    parser.add_argument("--untangle", action="store_true", help="mesh.untangle in every round and at the end")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the curves as JSON")
    parser.add_argument("--out", type=Path, help="write pictures and states")
    parser.add_argument("--quick", action="store_true", help="about a minute: 300 iterations at half size")
    options = parser.parse_args()
    if options.quick:
        options.iterations, options.downscale, options.texels = 300, 2 * options.downscale, 128
    return options


if __name__ == "__main__":
    main()
