"""What the studio costs: a large graph on its page, an edit of it, a large asset's first look, a run that is watched.

    python -m benchmarks.studio                          # all
    python -m benchmarks.studio --only paint
    python -m benchmarks.studio --only graph --nodes 1000
    python -m benchmarks.studio --only watch --graph graphs/quickstart.yaml --set pbr.iterations=100

Seconds are the best of some repeats, with the processor's beside them: on a busy machine the latter tell more. `paint`
and `watch` open the page in headless Chromium (`benchmarks.studio_page`).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.studio_page import paint, watch

ROOT = Path(__file__).parent.parent
TOY = ROOT / "tests" / "graph" / "toy"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("graph", "model", "paint", "watch"))
    parser.add_argument("--nodes", type=int, default=1000)
    parser.add_argument("--faces", type=int, default=200_000)
    parser.add_argument("--maps", type=int, default=2048)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--graph", type=Path, default=ROOT / "graphs" / "quickstart.yaml")
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="NAME=VALUE")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name, work in (("graph", graph), ("model", model), ("paint", paint), ("watch", watch)):
            if args.only in (None, name):
                print(f"\n{name}")
                for row in work(args, Path(folder) / name):
                    print("  " + "  ".join(f"{key}: {value}" for key, value in row.items()))


def graph(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """A graph of many nodes: the first document, an edit with its checks, an edit with its plan, what fits a port."""
    from benchmarks.framework import write_graph

    sys.path.insert(0, str(TOY))
    from exmesh_graph.graph.declare.packs import load_packs
    from exmesh_graph.studio.plans import plan_facts
    from exmesh_graph.studio.workspace import Workspace

    folder.mkdir(parents=True)
    load_packs()
    file = write_graph(folder, "mixed", args.nodes)
    number = iter(range(1, 10_000))

    def opened() -> Any:
        return Workspace(file, store=folder / ".exmesh", runs=folder / "runs").facts(wait=0)

    workspace = Workspace(file, store=folder / ".exmesh", runs=folder / "runs")

    def edit() -> Any:
        workspace.document.edit([{"set": "n0.value", "to": next(number)}])
        return workspace.document.judged()

    def edit_and_show() -> Any:
        edit()
        return workspace.facts(wait=0)

    for what, work in (
        ("first document, read and checked", opened),
        ("an edit's check", edit),
        ("an edit and its document", edit_and_show),
        ("a plan, nothing in the store", lambda: plan_facts(workspace.document.judged().checked, workspace.store())),
        ("what fits a port", lambda: workspace.document.ends().for_output("n1", "number", "")),
    ):  # fmt: skip
        yield {"what": what, "nodes": args.nodes, **best(work, args.repeats)}


def model(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """A large asset out of a store, read for the first time, in all levels."""
    import numpy as np

    from exmesh_graph.gallery.levels import levels_of, model_level
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.studio.artifacts.shelf import Shelf
    from exmesh_graph.types import Asset

    side = round((args.faces / 2) ** 0.5)
    x, y = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1))
    at = np.arange((side + 1) ** 2, dtype=np.int32).reshape(side + 1, side + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, 1:].ravel(), at[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    flat = np.stack([x.ravel(), y.ravel()], 1).astype(np.float32)
    height = 0.1 * np.sin(20 * flat[:, :1]) * np.cos(17 * flat[:, 1:])
    dice = np.random.default_rng(1)
    size = (args.maps, args.maps)
    asset = Asset(
        vertices=np.concatenate([flat - 0.5, height.astype(np.float32)], 1), faces=faces, uvs=flat, uv_faces=faces,
        texture=dice.random((*size, 3), np.float32), base_color=dice.random((*size, 3), np.float32),
        roughness=dice.random(size, np.float32), normal=dice.random((*size, 3), np.float32), seen=np.ones(size, bool),
        environment=np.ones((64, 128, 3), np.float32),
    )  # fmt: skip
    store = Store(folder)
    with store.attempt() as attempt:
        digest = store.put(asset, attempt).digest
    shelf = Shelf(lambda: store)
    for number, level in enumerate(levels_of(asset)):
        made: list[bytes] = []

        def look(level: Any = level, first: bool = number == 0, made: list[bytes] = made) -> None:
            value = Shelf(lambda: store).value(digest) if first else shelf.value(digest)
            made.append(model_level(value, level)[0])

        times = best(look, args.repeats)
        yield {"what": f"level {number}" + (", read and checked" if number == 0 else ""), "faces": args.faces,
               "maps": args.maps, "MB": round(len(made[-1]) / 1e6, 2), **times}  # fmt: skip


def best(work: Callable[[], Any], repeats: int) -> dict[str, Any]:
    """The least seconds, and the least processor seconds, of some repeats."""
    wall, processor = float("inf"), float("inf")
    for _ in range(repeats):
        began, spent = time.perf_counter(), time.process_time()
        work()
        wall, processor = min(wall, time.perf_counter() - began), min(processor, time.process_time() - spent)
    return {"s": round(wall, 3), "processor s": round(processor, 3)}


if __name__ == "__main__":
    main()
