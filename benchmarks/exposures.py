"""How well wandering exposures are found, and a scene that has them.

    python -m benchmarks.exposures graphs/samples/spot graphs/samples/chair    # a table
    python -m benchmarks.exposures graphs/samples/spot --out FOLDER            # that scene with exposures that wander
    exmesh run graphs/quickstart.yaml --set scene=FOLDER                       # against --set balanced.exposure=off

Training pictures are multiplied, in linear light, by 2 to the power of up to half a stop, red and blue by up to 0.15
stops more, cut off at 1 and written as before; test pictures stay. `rough`, and as part of the spread within a view, is
what `stage1.balance` decides by; `error` is the standard deviation of the exposures it finds from those that were put
in, `beyond its own` after what it finds in the scene as it was: gloss and an approximate surface.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.coarse_work import hull, load_scene
from benchmarks.register import choosing
from exmesh_graph.io.images import encode_rgba, read_photo, write_image
from exmesh_graph.stage1.exposure import balanced, exposures
from exmesh_graph.types import Mesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path, help="folders in the NeRF-Synthetic layout")
    parser.add_argument("--out", type=Path, help="write the first scene with wandering exposures here")
    parser.add_argument("--seed", type=int, default=7)
    args = parser.parse_args()
    if args.out is not None:
        wander(args.scenes[0], args.out, args.seed)
        return
    print("| scene | views | rough; of spread | wandering | error, stops | beyond its own |")
    print("| --- | --- | --- | --- | --- | --- |")
    for folder in args.scenes:
        choosing(folder)
        row(folder, args.seed)


def row(folder: Path, seed: int) -> None:
    """Print the line of one scene, by the hull of its masks."""
    loaded, case = load_scene(folder, 1, 0)
    views, mesh = loaded.train, Mesh(*hull(case, 48))
    stops = drawn(len(views), seed)
    exposed = balanced(views, -np.log(2) * stops)
    own = exposures(views, mesh)
    found = exposures(replace(exposed, images=np.minimum(np.asarray(exposed.images), 1)), mesh)
    error = found.stops - (stops - stops.mean(0))
    decides = " | ".join(f"{one.rough:.3f}; {one.rough / one.spread:.2f}" for one in (own, found))
    beyond = (error - own.stops).std()
    print(f"| `{folder.name}` | {len(views)} | {decides} | {error.std():.3f} | {beyond:.3f} |", flush=True)


def wander(folder: Path, out: Path, seed: int) -> None:
    """Copy the scene, with training pictures of wandering exposure."""
    shutil.copytree(folder, out)
    files = sorted(out.glob("train/*_rgba.png"))
    for file, gain in zip(files, np.exp2(drawn(len(files), seed)), strict=True):
        photo = read_photo(file)
        write_image(file, encode_rgba(photo.rgb * gain.astype(np.float32), photo.alpha))
    print(f"{out}: {len(files)} training pictures")


def drawn(count: int, seed: int) -> np.ndarray:
    """float64 [count, 3]: exposures in stops."""
    rng = np.random.default_rng(seed)
    tint = rng.uniform(-0.15, 0.15, (count, 3))
    tint[:, 1] = 0
    return rng.uniform(-0.5, 0.5, (count, 1)) + tint


if __name__ == "__main__":
    main()
