"""Peak memory of the whole chain on many large photographs: measured at a few numbers of them, and told for more.

    python -m benchmarks.many_pictures                                  # 12 and 24 pictures of 4000 x 3000
    python -m benchmarks.many_pictures --views 40 --tell 200 --steps load hull start refine fit score
    python -m benchmarks.many_pictures --width 800 --height 600 --views 10 20    # a try

A sphere on two fifths of each picture, 8-bit PNG with alpha, in the Blender layout. Every step is a process of its
own, which reads what the step before it stored: `load` reads files and saves views, `hull` finds the visual hull,
`start` projects the first texture, `refine` and `fit` make some iterations of Stage I and II with `--memory-gib` for
prepared pictures and buffers, `score` renders one test view and scores it. Columns: pictures, the step, its peak
resident memory (ru_maxrss), seconds, seconds of one iteration, and a hash of the result. With two numbers of pictures a
straight line through both peaks says what `--tell` pictures take.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

STEPS = ("load", "hull", "start", "refine", "fit", "score")
TEST = 3
_COARSE = 4


def main() -> int:
    options = arguments()
    if options.child:
        print(json.dumps(child(options)))
        return 0
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        rows = [row for views in options.views for row in measured(options, Path(folder), views)]
    for step in options.steps if len(options.views) > 1 else ():
        counts, peaks = zip(*[(row["views"], row["peak"]) for row in rows if row["step"] == step], strict=True)
        slope, base = np.polyfit(counts, peaks, 1)
        print(f"{step:7s} {base:6.2f} GiB + {1024 * slope:7.1f} MiB a picture: "
              f"{base + options.tell * slope:7.2f} GiB for {options.tell}")  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


def measured(options: argparse.Namespace, folder: Path, views: int) -> list[dict[str, Any]]:
    """A row for each step."""
    scene = folder / f"{views}"
    write_scene(scene, views, options.width, options.height)
    rows = []
    for step in options.steps:
        words = ["--child", step, "--scene", str(scene), "--memory-gib", str(options.memory_gib)]
        words += ["--downscale", str(options.downscale), "--iterations", str(options.iterations)]
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.many_pictures", *words], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(done.stderr)
        rows.append({"views": views, "step": step, **json.loads(done.stdout.splitlines()[-1])})
        row = rows[-1]
        print(f"{views:4d} {step:7s} {row['peak']:6.2f} GiB {row['seconds']:7.1f} s {row['iteration']:6.2f} s  "
              f"{row['hash'][:12]}  {row['said']}", flush=True)  # fmt: skip
    shutil.rmtree(scene)
    return rows


def child(options: argparse.Namespace) -> dict[str, Any]:
    """One step, in this process."""
    began = time.perf_counter()
    found, times, said = globals()[f"run_{options.child}"](options)
    return {
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "seconds": time.perf_counter() - began,
        "iteration": float(np.median(np.diff(times))) if len(times) > 1 else 0.0,
        "hash": hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in found)).hexdigest(),
        "said": said,
    }


def run_load(options: argparse.Namespace) -> tuple[list[np.ndarray], list[float], str]:
    from exmesh_graph.io.blender import load_blender
    from exmesh_graph.io.settings import BlenderOptions

    box = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
    scene = load_blender(options.scene, BlenderOptions(up="y", box=box, truth=False, downscale=options.downscale))
    for name in ("train", "test"):
        (options.scene / name / "saved").mkdir()
        getattr(scene, name).save(options.scene / name / "saved")
    np.save(options.scene / "frame.npy", scene.frame.scene_from_normalised)
    return [scene.train.images[0], scene.train.alpha[0], scene.train.camera_to_world], [], ""


def run_hull(options: argparse.Namespace) -> tuple[list[np.ndarray], list[float], str]:
    from exmesh_graph.geometry.hull import SilhouetteField, visual_hull

    return list(visual_hull(SilhouetteField.of_views(stored(options, "train")), resolution=64)), [], ""


def run_start(options: argparse.Namespace) -> tuple[list[np.ndarray], list[float], str]:
    from exmesh_graph.stage1.init import initial_state

    state = initial_state(carrier(options), stored(options, "train"))
    (options.scene / "state").mkdir()
    state.save(options.scene / "state")
    return [state.texture], [], ""


def run_refine(options: argparse.Namespace) -> tuple[list[np.ndarray], list[float], str]:
    from exmesh_graph.resources import memory_in_use
    from exmesh_graph.stage1.refine import refine
    from exmesh_graph.stage1.settings import RefineSettings
    from exmesh_graph.types import Stage1State

    times, note = _clock()
    settings = _known(RefineSettings, iterations=options.iterations, memory_gib=options.memory_gib)
    state, views, said = Stage1State.load(options.scene / "state"), stored(options, "train"), ""
    with contextlib.suppress(ModuleNotFoundError):  # a revision before it
        from exmesh_graph.stage1.memory import plan_memory

        said = f"announced {plan_memory(state, views, settings, memory_in_use()).total / 2**30:.2f} GiB"
    state, _ = refine(state, views, settings, checkpoint=note)
    return [state.vertices, state.texture], times, said


def run_fit(options: argparse.Namespace) -> tuple[list[np.ndarray], list[float], str]:
    from exmesh_graph.resources import memory_in_use
    from exmesh_graph.shading.transport import trace_transport, with_bounces
    from exmesh_graph.stage2.fit import fit
    from exmesh_graph.stage2.memory import plan_memory
    from exmesh_graph.stage2.settings import DecompositionSettings

    shape, views = carrier(options), stored(options, "train")
    light = with_bounces(trace_transport(shape.vertices, shape.faces, 64, 2), 1)
    settings = DecompositionSettings(iterations=options.iterations, corrections=1, memory_gib=options.memory_gib)
    times, note = _clock()
    plan = plan_memory(shape, views, light, settings, memory_in_use())
    asset, _ = fit(shape, views, light, settings, checkpoint=note)
    (options.scene / "asset").mkdir()
    asset.save(options.scene / "asset")
    return [asset.base_color, asset.roughness, asset.environment], times, f"announced {plan.total / 2**30:.2f} GiB"


def run_score(options: argparse.Namespace) -> tuple[list[np.ndarray], list[float], str]:
    from exmesh_graph.evaluate.asset import score_asset
    from exmesh_graph.evaluate.settings import Quality
    from exmesh_graph.types import Asset

    quality = Quality(directions=32, bounces=0, supersampling=1, specular_samples=1)
    asset, tests = Asset.load(options.scene / "asset"), stored(options, "test")
    scores = score_asset(asset, tests, train=stored(options, "train"), max_views=1, quality=quality)
    db = scores.values["held_out"]["psnr"]
    return [np.array([db, scores.values["floor"]["light_level"]])], [], f"{db:.2f} dB"


def stored(options: argparse.Namespace, name: str) -> Any:
    from exmesh_graph.types import Views

    return Views.load(options.scene / name / "saved")


def carrier(options: argparse.Namespace) -> Any:
    """The photographed sphere in the normalised world."""
    from benchmarks.stability.stage2_scenes import sphere

    shape, frame = sphere(), np.load(options.scene / "frame.npy")
    to = np.linalg.inv(frame)
    vertices = (shape.vertices @ to[:3, :3].T + to[:3, 3]).astype(np.float32)
    return replace(shape, vertices=vertices, texture=np.full((1024, 1024, 3), 0.5, np.float32))


def write_scene(folder: Path, count: int, width: int, height: int) -> None:
    """`count` training views and three test views of a sphere coloured by position."""
    from benchmarks.stability.stage2_scenes import cameras
    from exmesh_graph.io.images import write_codes

    focal = 1.7 * height
    for split, number, turn in (("train", count, 0.0), ("test", TEST, 0.05)):
        (folder / split).mkdir(parents=True)
        frames = []
        for k, pose in enumerate(cameras(number, height, turn)[1]):
            rgba = _picture(pose, width // _COARSE, height // _COARSE, focal / _COARSE)
            large = np.repeat(np.repeat(rgba, _COARSE, 0), _COARSE, 1)
            large[..., :3] += (k + np.arange(width) % 2)[None, :, None].astype(np.uint8)  # not blocks alone
            write_codes(folder / split / f"{k:03d}.png", large)
            matrix = (pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()
            frames.append({"file_path": f"{split}/{k:03d}", "transform_matrix": matrix})
        content = {"camera_angle_x": 2 * float(np.arctan(width / 2 / focal)), "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(content), encoding="utf-8")


def _picture(pose: np.ndarray, width: int, height: int, focal: float) -> np.ndarray:
    """uint8 [H, W, 4] of a sphere of radius 0.6 around the origin."""
    x, y = np.meshgrid((np.arange(width) + 0.5 - width / 2) / focal, (np.arange(height) + 0.5 - height / 2) / focal)
    ray = np.stack([x, y, np.ones_like(x)], -1) @ pose[:3, :3].T
    a, b, c = (ray * ray).sum(-1), ray @ pose[:3, 3], pose[:3, 3] @ pose[:3, 3] - 0.36
    root = b * b - a * c
    point = pose[:3, 3] + ((-b - np.sqrt(np.maximum(root, 0))) / a)[..., None] * ray
    colour = np.where((root > 0)[..., None], 100 + 120 * point, 0)
    return np.dstack([colour, 255 * (root > 0)]).astype(np.uint8)


def _clock() -> tuple[list[float], Callable[..., None]]:
    times: list[float] = []
    return times, lambda *_: times.append(time.perf_counter())


def _known(settings: Any, **values: Any) -> Any:
    """The settings, without parameters that a revision does not have yet."""
    return settings(**{name: value for name, value in values.items() if name in settings.model_fields})


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.many_pictures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--views", type=int, nargs="+", default=[12, 24])
    parser.add_argument("--tell", type=int, default=200)
    parser.add_argument("--width", type=int, default=4000)
    parser.add_argument("--height", type=int, default=3000)
    parser.add_argument("--downscale", type=int, default=1, help="of the loader")
    parser.add_argument("--iterations", type=int, default=4)
    parser.add_argument("--memory-gib", type=float, default=1.0)
    parser.add_argument("--steps", nargs="+", choices=STEPS, default=list(STEPS))
    parser.add_argument("--folder", type=Path, help="where the scenes are written, and removed in the end")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--child", choices=STEPS, default="", help=argparse.SUPPRESS)
    parser.add_argument("--scene", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
