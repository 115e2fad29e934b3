"""Stage I as rounds of nodes against the same calls in one plain loop: what the unrolling costs.

    python -m benchmarks.unrolled                    # the sample scene, 4 rounds of 400 iterations: some minutes
    python -m benchmarks.unrolled --quick            # small pictures, 3 rounds of 60
    python -m benchmarks.unrolled --json out.json

Per repeat, in turn: the rounds as a graph on worker processes, the same graph in one process, and the loop, which calls
the nodes' own functions with values in memory, stores nothing and checks nothing. Times are from the start of the first
round to the end of the last, so without imports and preparations. All end with the same bytes, which is asserted.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
GRAPH = """
name: unrolled
params: {{scene: {scene}, downscale: {downscale}, texels: {texels}, resolution: {resolution}, faces: {faces}}}
nodes:
  views: {{type: data.blender, path: "${{scene}}", downscale: "${{downscale}}"}}
  hull: {{type: init.visual_hull, views: "@views.train", resolution: "${{resolution}}"}}
  clean: {{type: init.clean, mesh: "@hull.mesh", faces: {start_faces}}}
  atlas: {{type: uv.unwrap, mesh: "@clean.mesh", texture_size: "${{texels}}"}}
  start: {{type: stage1.init, carrier: "@atlas.carrier", views: "@views.train"}}
  rounds:
    repeat: {rounds}
    carry: {{state: "@start.state"}}
    nodes:
      refine: {{type: stage1.refine, state: "@carry.state", views: "@views.train", iterations: {iterations}}}
      split: {{type: mesh.split, state: "@refine.state", max_faces: "${{faces}}"}}
      merge: {{type: mesh.merge, state: "@split.state", views: "@views.train"}}
      uv: {{type: uv.maintain, state: "@merge.state"}}
    next: {{state: "@uv.state"}}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small pictures, 3 rounds of 60 iterations")
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--iterations", type=int, help="of one round")
    parser.add_argument("--texels", type=int, help="side of the texture")
    parser.add_argument("--repeats", type=int)
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    args = parser.parse_args()
    sizes = {"rounds": 4, "iterations": 400, "texels": 512, "resolution": 64, "faces": 16000, "start_faces": 4000}
    sizes["downscale"] = 2
    if args.quick:
        sizes = {"rounds": 3, "iterations": 60, "texels": 128, "resolution": 32, "faces": 4000, "start_faces": 2000}
        sizes["downscale"] = 4
    sizes.update({name: value for name, value in vars(args).items() if name in sizes and value})
    os.environ["OMP_NUM_THREADS"] = "1"  # as workers have it
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), sizes, args.repeats or (2 if args.quick else 3))
    print(f"{sizes['rounds']} rounds of {sizes['iterations']} iterations, texture {sizes['texels']}, best of repeats")
    print("| | seconds | over the loop |\n| --- | --- | --- |")
    for name, seconds in found.items():
        print(f"| {name} | {seconds:.2f} | {100 * (seconds / found['loop'] - 1):+.1f} % |")
    if args.json:
        args.json.write_text(json.dumps({"sizes": sizes, "seconds": found}, indent=1) + "\n")


def measure(folder: Path, sizes: Mapping[str, int], repeats: int) -> dict[str, float]:
    """Best seconds of each way; the ways take turns."""
    from exmesh_graph.graph.declare.packs import load_packs
    from exmesh_graph.graph.language.check import check_file

    path = folder / "unrolled.yaml"
    path.write_text(GRAPH.format(scene=ROOT / "graphs" / "samples" / "spot", **sizes))
    graph = check_file(path, [], load_packs())
    run(graph, folder, "base", 0, graph.needed_for(["start"]))
    best: dict[str, float] = {}
    states = set()
    for repeat in range(repeats):
        for name, workers in (("nodes, worker process", None), ("nodes, one process", 0), ("loop", -1)):
            if workers == -1:
                seconds, digest = loop(graph, folder)
            else:
                store = f"{repeat}{workers}"
                shutil.copytree(folder / "base", folder / store, copy_function=os.link)
                seconds, digest = run(graph, folder, store, workers)
                shutil.rmtree(folder / store)
            states.add(digest)
            best[name] = min(seconds, best.get(name, seconds))
    assert len(states) == 1, "the ways end with different bytes"
    return best


def run(
    graph: Any, folder: Path, store: str, workers: int | None, targets: set[str] | None = None
) -> tuple[float, str]:
    """(seconds of the rounds, digest of the last state) of a run."""
    from exmesh_graph.api.runs import backend_of
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.run.rundir import RunFolder
    from exmesh_graph.graph.run.runner import Runner

    opened, runs, events = Store(folder / store), RunFolder(folder / "runs", "unrolled"), []
    force = {"start"} if workers is None else set()  # a warm worker, as after the preparations
    try:
        backend = backend_of(workers, opened)
        work = Runner(graph, opened, runs, events.append, backend=backend, targets=targets, force=force)
        record = work.run()
    finally:
        runs.close()
    if targets is not None:
        return 0.0, ""
    began = next(e["time"] for e in events if e["event"] == "node_started" and e["node"].startswith("rounds"))
    last = max(e["time"] for e in events if e["event"] == "node_finished")
    return last - began, record["nodes"][-1]["outputs"]["state"]["digest"]


def loop(graph: Any, folder: Path) -> tuple[float, str]:
    """The rounds as plain calls of the nodes' functions."""
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.testing import FakeContext

    store = Store(folder / "base")
    state, views = _value(graph, store, "start", "state"), _value(graph, store, "views", "train")
    rounds = [bound for name, bound in graph.nodes.items() if name.startswith("rounds")]
    began = time.perf_counter()
    for bound in rounds:
        values = {"state": state, "views": views}
        given = {port: values[port] for port in bound.inputs}
        state = bound.definition.function(FakeContext(node=bound.name, seed=bound.seed), **given, p=bound.params)[0]
    seconds = time.perf_counter() - began
    with store.attempt() as attempt:
        return seconds, store.put(state, attempt).digest


def _value(graph: Any, store: Any, node: str, port: str) -> Any:
    from exmesh_graph.graph.declare.ports import artifact_types
    from exmesh_graph.graph.run.plan import plan

    step = next(step for step in plan(graph, store) if step.name == node)
    stored = step.action.outputs[port]
    return store.load(artifact_types()[stored.type], stored.digest)


if __name__ == "__main__":
    main()
