"""Stage I with faults in its data, beside the clean run: what they cost, and which views the diagnosis names.

    python -m benchmarks.robust_stage1 graphs/samples/spot            # the sample, 256 x 256
    python -m benchmarks.robust_stage1 graphs/samples/spot --quick    # 128 x 128, a quarter of the iterations

Faults: every 10th mask missing (the photograph over a patterned ground instead);
one camera turned by 2 degrees; an object that is black, on black ground; the exposure of every other view halved. Rows
marked + do what the warning advises: the named views left out, `wrong_masks: 1` for the hull, `gains: true`. Chamfer in
thousandths of the bounding radius, PSNR over the clean held-out views (with one gain a view where exposures differ: the
texture's own exposure is then arbitrary).
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from exmesh_nodes import data, init, stage1, topology, uv

from benchmarks.stage1 import score
from exmesh_graph.types import Views


class Listening:
    """The context the nodes ask for; keeps their warnings."""

    node, scratch, seed = "benchmark", Path(), 0

    def __init__(self) -> None:
        self.told: list[str] = []

    def progress(self, step: int, total: int, **figures: float) -> None: ...
    def checkpoint(self, step: int, state: object) -> None: ...
    def log(self, message: str) -> None: ...
    def resume(self) -> None: ...
    def warn(self, message: str) -> None:
        self.told.append(message)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    scene = data.blender(Listening(), p=data.BlenderParams(path=options.scene, downscale=2 if options.quick else 1))
    rounds = ((2000, 100), (6000, 150)) if options.quick else ((2000, 400), (8000, 600))
    views, every = scene.train, list(range(5, len(scene.train), 10))
    wrong = len(views) // 2
    cases = {
        "clean": (views, {}),
        "10 % of masks missing": (unmasked(views, every), {}),
        "one camera off by 2 degrees": (turned(views, wrong), {}),
        "+ wrong_masks 1": (turned(views, wrong), {"wrong_masks": 1}),
        "+ the named view left out": (without(views, [wrong]), {}),
        "black on black": (replace(views, images=views.images * 1e-3), {}),
        "every other exposure halved": (exposed(views), {}),
        "+ gains": (exposed(views), {"gains": True}),
    }
    print(f"{'fault':<30}{'Chamfer':>9}{'PSNR':>8}{'exposed':>9}{'alpha':>8}   suspects, and views named dark or bare")
    rows = []
    for name, (faulty, more) in cases.items():
        figures, suspects, told = run(
            faulty, scene.test, (scene.truth.mesh_vertices, scene.truth.mesh_faces), rounds, **more
        )
        rows.append({"fault": name, **figures, "suspects": suspects, "warnings": told})
        words = [*suspects, *(w.split(":")[0] for w in told if not w.startswith("view "))]
        print(
            f"{name:<30}{figures['chamfer']:9.3f}{figures['psnr']:8.2f}{figures['psnr_exposed']:9.2f}"
            f"{figures['alpha']:8.2f}   {'; '.join(words) or '-'}",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def run(views: Views, test: Views, truth, rounds, *, wrong_masks: int = 0, gains: bool = False):
    """(scores, suspects, warnings) of a short Stage I."""
    ctx = Listening()
    mesh = init.visual_hull(ctx, views, p=init.HullSettings(resolution=96, wrong_masks=wrong_masks)).mesh
    mesh = init.clean(ctx, mesh, p=init.CleanSettings(faces=rounds[0][0])).mesh
    carrier = uv.unwrap(ctx, mesh, p=uv.UnwrapParams(texture_size=views.width)).carrier
    state = stage1.init(ctx, carrier, views, p=stage1.InitParams(device="cpu")).state
    total = sum(iterations for _, iterations in rounds)
    suspects: dict[str, str] = {}
    ctx.told.clear()
    for k, (faces, iterations) in enumerate(rounds):
        if k:
            state = topology.split(ctx, state, p=topology.SplitParams(target_faces=faces)).state
            state = uv.regenerate(ctx, state, p=uv.RegenerateParams()).state
        params = stage1.RefineParams(iterations=iterations, total_iterations=total, gains=gains, device="cpu")
        state, history = stage1.refine(ctx, state, views, p=params)
        suspects = history.values.get("suspects", {})
    return score(state, test, truth), suspects, list(dict.fromkeys(ctx.told))


def unmasked(views: Views, which: list[int]) -> Views:
    images, alpha = views.images.copy(), views.alpha.copy()
    y, x = np.mgrid[: views.height, : views.width] / views.height
    ground = 0.1 + 0.1 * np.stack([np.sin(40 * x), np.sin(31 * y), np.sin(23 * (x + y))], axis=-1) ** 2
    for i in which:
        images[i] += (1 - alpha[i])[..., None] * ground.astype(np.float32)
        alpha[i] = 1.0
    return replace(views, images=images, alpha=alpha)


def turned(views: Views, which: int, degrees: float = 2.0) -> Views:
    poses = views.camera_to_world.copy()
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    poses[which, :3, :3] = poses[which, :3, :3] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return replace(views, camera_to_world=poses)


def exposed(views: Views) -> Views:
    factor = np.where(np.arange(len(views)) % 2, 0.5, 1.0).astype(np.float32)
    return replace(views, images=views.images * factor[:, None, None, None])


def without(views: Views, which: list[int]) -> Views:
    return views.subset([i for i in range(len(views)) if i not in which])


if __name__ == "__main__":
    main()
