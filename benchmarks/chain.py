"""The whole chain on the sample scene: seconds of every node beside the errors they bought.

    python benchmarks/chain.py [--graph graphs/quickstart.yaml] [--set NAME=VALUE ...] [--json FILE]

Three runs through the command line in a temporary store: a fresh one, the same again (everything from the store), and
one with a parameter of Stage II changed, which must leave everything before Stage II alone. Prints both tables and
fails when a cache promise is broken.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STAGE_2_CHANGE = "pbr.material_rate=0.04"


def main() -> None:
    """Run, check, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--graph", type=Path, default=ROOT / "graphs" / "quickstart.yaml")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="passed on to exmesh run")
    parser.add_argument("--change", default=STAGE_2_CHANGE, help="the Stage II parameter that the third run changes")
    parser.add_argument("--json", type=Path, help="also write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="exmesh-chain-") as folder:
        fresh, fresh_wall = run(options.graph, Path(folder), options.set)
        print_nodes(fresh)
        print_headline(fresh)
        again, again_wall = run(options.graph, Path(folder), options.set)
        changed, changed_wall = run(options.graph, Path(folder), [*options.set, options.change])
    missed = ran(again)
    redone = ran(changed)
    upstream = [name for name in redone if name in before_stage_2(changed)]
    print(f"\nfresh run              {fresh_wall:8.2f} s wall, {len(ran(fresh))} of {len(fresh['nodes'])} nodes ran")
    print(f"the same again         {again_wall:8.2f} s wall, {len(missed)} nodes ran")
    print(f"{options.change:<22} {changed_wall:8.2f} s wall, {len(redone)} nodes ran: {', '.join(redone)}")
    if options.json:
        walls = {"fresh": fresh_wall, "again": again_wall, "changed": changed_wall}
        options.json.write_text(json.dumps({"wall_seconds": walls, "redone": redone, "report": fresh}, indent=1) + "\n")
    if missed or upstream or not redone:
        sys.exit(f"a cache promise is broken: ran again {missed}; before Stage II {upstream}; changed {redone}")


def run(graph: Path, folder: Path, overrides: list[str]) -> tuple[dict, float]:
    """One `exmesh run`: (report.json, wall seconds with the start of Python)."""
    main_of_cli = "import sys; from exmesh_graph.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", main_of_cli, "run", str(graph)]
    command += ["--store", str(folder / "store"), "--runs", str(folder / "runs")]
    for override in overrides:
        command += ["--set", override]
    started = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    wall = time.perf_counter() - started
    if done.returncode:
        sys.exit(f"exmesh {' '.join(command[3:])} failed:\n{done.stdout}")
    return json.loads((folder / "runs" / "latest" / "report.json").read_text(encoding="utf-8")), wall


def ran(report: dict) -> list[str]:
    """Nodes that this run executed."""
    return [node["name"] for node in report["nodes"] if node["state"] != "hit"]


def before_stage_2(report: dict) -> set[str]:
    """Everything that Stage II (nodes of the type stage2.fit) depends on."""
    types = {node["name"]: node["type"] for node in report["nodes"]}
    found: set[str] = set()
    todo = [name for name, kind in types.items() if kind == "stage2.fit"]
    while todo:
        consumer = todo.pop()
        for producer, name in report["edges"]:
            if name == consumer and producer not in found:
                found.add(producer)
                todo.append(producer)
    return found


def print_nodes(report: dict) -> None:
    """Seconds, share and peak memory of every node."""
    total = report["seconds"]["all_results"]
    print(f"{'node':<22} {'type':<22} {'seconds':>9} {'share':>6} {'peak MB':>8}")
    for node in report["nodes"]:
        share, peak = 100 * node["seconds"] / max(total, 1e-9), node["peak_memory"] / 1e6
        print(f"{node['name']:<22} {node['type']:<22} {node['seconds']:9.2f} {share:5.1f}% {peak:8.0f}")
    print(f"{'sum':<45} {total:9.2f}")


def print_headline(report: dict) -> None:
    """Each figure, the score of an uninformed guess, and the seconds spent until the scored value was there."""
    print(f"\n{'figure':<28} {'value':>10} {'guess':>10} {'after s':>9}")
    for label, figure in report["headline"].items():
        cells = [figure["value"], figure["floor"], figure["after_seconds"]]
        shown = [f"{c:.4g}" if isinstance(c, float) else "" if c is None else str(c) for c in cells]
        print(f"{label:<28} {shown[0]:>10} {shown[1]:>10} {shown[2]:>9}  {figure['unit']}")


if __name__ == "__main__":
    main()
