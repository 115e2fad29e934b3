"""Stage I, error against seconds: hull -> atlas -> rounds of refine and split, scored after every round.

    python benchmarks/stage1.py graphs/samples/spot
    python benchmarks/stage1.py path/to/temple_ring --layout middlebury --downscale 2 --gains --silhouette-weight 1

Prints one line per round (seconds of Stage I so far, faces, Chamfer distance in thousandths of the bounding radius,
held-out display PSNR, 1000 x mean |alpha - mask|) and writes JSON and pictures where --out says.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from exmesh_nodes import data, init, regulariser, stage1, topology, uv

from exmesh_graph.losses import display
from exmesh_graph.metrics.image import psnr
from exmesh_graph.stage1.render import render_carrier


class Quiet:
    """The context the nodes ask for."""

    node, scratch = "benchmark", Path()

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def progress(self, step: int, total: int, **figures: float) -> None: ...
    def log(self, message: str) -> None: ...
    def warn(self, message: str) -> None:
        print("warning:", message)


def main() -> None:
    options = arguments()
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
    mesh = init.visual_hull(ctx, scene.train, p=init.HullParams(resolution=96, dissent=options.dissent)).mesh
    mesh = init.clean(ctx, mesh, p=init.CleanParams(faces=options.faces[0])).mesh
    carrier = uv.unwrap(ctx, mesh, p=uv.UnwrapParams(texture_size=options.texels)).carrier
    hull_seconds = time.perf_counter() - began
    began = time.perf_counter()
    state = stage1.init(ctx, carrier, scene.train, p=stage1.InitParams(texture=options.start)).state
    seconds = time.perf_counter() - began
    print(f"hull, remesh, atlas {hull_seconds:.1f} s; texture from the views {seconds:.1f} s")
    rows = [{"seconds": seconds, **score(state, scene.test, truth)}]
    show(rows[-1], state)
    total = sum(options.iterations)
    kinds = {"laplacian": regulariser.Laplacian, "bilaplacian": regulariser.Bilaplacian}
    smoothness = kinds[options.smoothness](weight=options.smoothness_weight)
    fixed = {
        key: getattr(options, key)
        for key in ("vertex_lr", "texture_lr", "silhouette_weight", "gains", "ssim_weight", "decay")
    } | {"uv_gradient": not options.no_uv_gradient, "threads": options.threads}  # fmt: skip
    for k, (faces, iterations) in enumerate(zip(options.faces, options.iterations, strict=True)):
        began = time.perf_counter()
        if k and options.split == "uniform":
            state = topology.split(ctx, state, p=topology.SplitParams(method="uniform")).state
        elif k:
            state = topology.split(ctx, state, p=topology.SplitParams(target_faces=faces)).state
        if k in options.regen:
            state = uv.regenerate(ctx, state, p=uv.RegenerateParams()).state
        params = stage1.RefineParams(iterations=iterations, total_iterations=total, **fixed)
        state, history = stage1.refine(Quiet(options.seed + k), state, scene.train, smoothness=smoothness, p=params)
        seconds += time.perf_counter() - began
        rows.append({"seconds": seconds, "train_psnr": history.values["psnr"][-1], **score(state, scene.test, truth)})
        show(rows[-1], state)
    if options.out:
        write(options.out, state, scene.test, rows)


def score(state, views, truth) -> dict[str, float]:
    colours, alphas = render_carrier(state, views)
    target = display(torch.from_numpy(views.images), torch.from_numpy(views.alpha)).numpy()
    found = {
        "faces": len(state.faces),
        "psnr": float(np.mean([psnr(a, b) for a, b in zip(colours, target, strict=True)])),
        "alpha": 1000 * float(np.abs(alphas - views.alpha).mean()),
    }
    # what is left once each held-out view has its own exposure
    gain = (colours * target).sum((1, 2)) / np.maximum((colours**2).sum((1, 2)), 1e-9)
    exposed = np.clip(colours * gain[:, None, None], 0, 1)
    found["psnr_exposed"] = float(np.mean([psnr(a, b) for a, b in zip(exposed, target, strict=True)]))
    if truth is not None:
        from exmesh_graph.metrics.mesh import bounding_radius, chamfer

        result = chamfer(state.vertices, state.faces, *truth)
        found["chamfer"] = 1000 * result.chamfer / bounding_radius(truth[0])
    return found


def show(row: dict[str, float], state) -> None:
    print("  ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)


def write(folder: Path, state, views, rows) -> None:
    from exmesh_graph.io.images import write_image

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stage1.json").write_text(json.dumps(rows, indent=1) + "\n")
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
    parser.add_argument("--dissent", type=int, default=0)
    parser.add_argument("--texels", type=int, default=256)
    parser.add_argument("--faces", type=int, nargs="+", default=[2000, 8000, 32000])
    parser.add_argument("--iterations", type=int, nargs="+", default=[600, 900, 1500])
    parser.add_argument("--split", choices=("score", "uniform"), default="uniform")
    parser.add_argument("--regen", type=int, nargs="*", default=[], help="rounds that begin with a new atlas")
    parser.add_argument("--start", choices=("views", "grey"), default="views")
    parser.add_argument("--vertex-lr", type=float, default=0.02)
    parser.add_argument("--texture-lr", type=float, default=0.02)
    parser.add_argument("--decay", type=float, default=0.05)
    parser.add_argument("--ssim-weight", type=float, default=0.2)
    parser.add_argument("--smoothness", choices=("laplacian", "bilaplacian"), default="bilaplacian")
    parser.add_argument("--smoothness-weight", type=float, default=0.3)
    parser.add_argument("--silhouette-weight", type=float, default=5.0)
    parser.add_argument("--no-uv-gradient", action="store_true")
    parser.add_argument("--gains", action="store_true")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
