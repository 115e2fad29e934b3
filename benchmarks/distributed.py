"""A sweep of scenes and variants on a local Ray cluster with one store; a worker is killed on the way.

    python -m benchmarks.distributed FOLDER                    # 2 scenes x 3 variants of Stage I, some minutes
    python -m benchmarks.distributed FOLDER --quick            # shorter schedule
    python -m benchmarks.distributed FOLDER --kill machine     # lose one of the machines (node processes) instead
    python -m benchmarks.distributed FOLDER --graph G.yaml     # any graph with variants or a matrix

Prints what was lost and resumed, and the one table of the sweep. The scenes are two choices of the sample's views. On a
real cluster only the sweep is needed: `exmesh sweep G.yaml --backend ray --address auto --store /shared/store`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

OBJECT_STORE = 80 * 2**20  # bytes; data moves through the graph's store, not through Ray's
SWEEP = """
extends: {root}/graphs/hull.yaml
name: scenes
nodes: {{light: null, probe: null, neutral: null, bounce: null, pbr: null, reshape: null, retouch: null, usd: null,
        score: null, score_pictures: null, shape: {{mesh: "@settle.state"}}}}
outputs: {{asset: null}}
variants:
  only_split: [{{bypass: rounds.merge}}]
  no_flip: [{{bypass: rounds.flip}}]
matrix:
  scene: [{folder}/scenes/front, {folder}/scenes/all]
  variant: [base, only_split, no_flip]
"""
LONG = ("rounds.repeat=3", "rounds.refine.iterations=60", "settle.iterations=150", "hull.resolution=64", "faces=6000",
        "texels=128", "shape.samples=10000", "look.max_views=4")  # fmt: skip
SHORT = ("rounds.repeat=2", "rounds.refine.iterations=12", "settle.iterations=40", "hull.resolution=48", "faces=3000",
         "coarse.faces=800", "texels=128", "shape.samples=4000", "look.max_views=2")  # fmt: skip


def main() -> None:
    """Write the scenes unless a graph is given, sweep, tell."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.distributed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="where scenes, store and runs go")
    parser.add_argument("--graph", type=Path, help="instead of Stage I of the sample")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="passed on to exmesh sweep")
    parser.add_argument("--machines", type=int, default=2, help="node processes of Ray with a core each")
    parser.add_argument("--kill", choices=["worker", "machine", "none"], default="worker")
    parser.add_argument("--quick", action="store_true", help="a shorter schedule")
    parser.add_argument("--json", type=Path, help="write what happened here")
    options = parser.parse_args()
    folder = options.folder.resolve()
    graph, sets = options.graph, list(options.set)
    if graph is None:
        graph, sets = write_sweep(folder), [*(SHORT if options.quick else LONG), *sets]
    told = sweep(graph, folder, sets, options.machines, options.kill)
    print(told["printed"])
    print(f"\n{options.machines} machines, {told['seconds']:.0f} s; killed: {told['killed'] or 'nothing'}")
    for line in told["messages"]:
        print(f"  {line}")
    if options.json:
        options.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


def write_sweep(folder: Path) -> Path:
    """Two scenes of 64 x 64 pixels, twelve views of one side's half and of all sides, and the sweep over them."""
    from benchmarks.layouts import ROOT, SAMPLE, _shots, write_nerf_synthetic

    angle = json.loads((SAMPLE / "transforms_train.json").read_text(encoding="utf-8"))["camera_angle_x"]
    train, test = _shots("train", 4, 24), _shots("test", 4, 3)
    for name, shots in (("front", train[:12]), ("all", train[::2])):
        write_nerf_synthetic(folder / "scenes" / name, shots, test, angle)
    graph = folder / "scenes.yaml"
    graph.write_text(SWEEP.format(root=ROOT, folder=folder), encoding="utf-8")
    return graph


def sweep(graph: Path, folder: Path, sets: list[str], machines: int, kill: str) -> dict[str, Any]:
    """Run the sweep on a cluster of its own: what it printed, its table, what was killed, what the run said of it."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "object_store_memory": OBJECT_STORE})
    try:
        for _ in range(machines):
            cluster.add_node(num_cpus=1, object_store_memory=OBJECT_STORE)
        cluster.wait_for_nodes()
        words = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "sweep", str(graph)]
        words += [word for text in sets for word in ("--set", text)]
        words += ["--backend", "ray", "--address", cluster.address, "--store", str(folder / "store")]
        before = set((folder / "runs").glob("*/events.jsonl"))
        begun = time.perf_counter()
        with subprocess.Popen(
            [*words, "--runs", str(folder / "runs")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as child:
            killed: list[str] = []
            watch = threading.Thread(target=_kill, args=(cluster, kill, folder, before, child, killed))
            watch.start()
            printed = child.communicate()[0]
            watch.join()
        seconds = time.perf_counter() - begun
    finally:
        cluster.shutdown()
    if child.returncode:
        raise SystemExit(f"the sweep failed:\n{printed[-4000:]}")
    events = next(iter(set((folder / "runs").glob("*/events.jsonl")) - before))
    said = [(entry.get("node"), entry.get("message", "")) for entry in _events(events) if entry["event"] == "log"]
    table = json.loads((events.parent / "sweep.json").read_text(encoding="utf-8"))
    return {
        "printed": printed.strip(),
        "seconds": seconds,
        "killed": killed[0] if killed else "",
        "messages": [f"{node}: {text}" for node, text in said if "Ray lost" in text or "goes on from" in text],
        "variants": {row["variant"]: row for row in table["variants"]},
    }


def _kill(cluster: Any, what: str, folder: Path, before: set[Path], child: Any, killed: list[str]) -> None:
    """As soon as a node that keeps checkpoints is some steps on."""
    import psutil

    while what != "none" and child.poll() is None:
        time.sleep(0.1)
        new = set((folder / "runs").glob("*/events.jsonl")) - before
        steps = [entry for file in new for entry in _events(file) if entry["event"] == "progress"]
        if not any(entry["step"] >= 5 for entry in steps):
            continue
        if what == "machine":
            cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)
            killed.append("a machine, with all its processes")
            return
        for machine in cluster.worker_nodes:
            raylet = machine.all_processes["raylet"][0].process.pid
            with contextlib.suppress(psutil.Error):  # a process that ends while it is looked at
                for process in psutil.Process(raylet).children(recursive=True):
                    if process.cmdline()[:1] == ["ray::work"]:
                        os.kill(process.pid, signal.SIGKILL)
                        killed.append(f"the Ray worker {process.pid}, by SIGKILL")
                        return


def _events(file: Path) -> list[dict[str, Any]]:
    """The whole lines of an event file that may still grow."""
    lines = file.read_text(encoding="utf-8").split("\n")[:-1]
    return [json.loads(line) for line in lines]


if __name__ == "__main__":
    main()
