"""What a time gives: the budgets of graphs/quickstart.yaml over scenes, seconds beside the errors that they bought.

    python -m benchmarks.budgets graphs/samples/spot FOLDER/concave --budget 1min --budget 5min
    python -m benchmarks.budgets graphs/samples/chair --json budgets.json

Each row is one `exmesh run` in a process and a store of its own, as a user has it, from start to report: seconds on the
clock, processor seconds of all its processes, and the load of the machine beforehand. On a machine that others use the
clock says nothing; processor seconds do, of which two quiet cores do one and a half a second. `used` is that estimate
over the budget; `clock` the clock's seconds over it. Errors are those of the full score of the same asset (all held-out
views, full quality), made afterwards and not counted in the seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import processor

ROOT = Path(__file__).resolve().parents[1]
SECONDS = {"1min": 60, "5min": 300, "30min": 1800}
FULL = ("scored_views=0", "supersampling=2")
AT_ONCE = 1.5  # processor seconds that two quiet cores do in a second of such a run
FIGURES = {
    "Chamfer": "Chamfer", "Held-out PSNR": "held-out", "Relit PSNR": "relit", "Albedo PSNR (linear)": "albedo",
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.budgets", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE")
    parser.add_argument("--budget", action="append", choices=["none", *SECONDS], help="default: 1min and 5min")
    parser.add_argument("--graph", type=Path, default=ROOT / "graphs" / "quickstart.yaml")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="as for exmesh run")
    parser.add_argument("--no-score", action="store_true", help="seconds alone; errors as the budget itself scores")
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    print(
        f"{processor()}, {len(os.sched_getaffinity(0))} cores; Chamfer in thousandths of the radius, the others in dB"
    )
    print("| " + " | ".join(HEADS) + " |\n|" + " --- |" * len(HEADS), flush=True)
    rows = []
    for scene in options.scenes:
        for budget in options.budget or ["1min", "5min"]:
            rows.append(measured(options.graph, scene, budget, options.set, score=not options.no_score))
            print(line(rows[-1]), flush=True)
            if options.json:
                options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def measured(graph: Path, scene: Path, budget: str, sets: Sequence[str], *, score: bool = True) -> dict[str, Any]:
    """One run and its row."""
    given = [f"scene={scene.resolve()}", f"budget={budget}", *sets]
    with tempfile.TemporaryDirectory(prefix="exmesh-budget-") as folder:
        load, before, began = os.getloadavg()[0], _spent(), time.perf_counter()
        report = run(graph, Path(folder), given)
        seconds, spent = time.perf_counter() - began, _spent() - before
        if score:
            report = run(graph, Path(folder), [*given, *FULL], "--node", "score", "--node", "shape")
    figures = {name: metric["value"] for name, metric in report["headline"].items()}
    row = {"scene": scene.name, "budget": budget, "seconds": seconds, "processor_seconds": spent, "load": load}
    return row | {short: figures.get(name) for name, short in FIGURES.items()}


def run(graph: Path, folder: Path, sets: Sequence[str], *words: str) -> dict[str, Any]:
    """The report of one `exmesh run` with a store and runs in `folder`."""
    start = "import sys; from exmesh_graph.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "run", str(graph), "--store", str(folder / "store")]
    command += ["--runs", str(folder / "runs"), *words]
    for text in sets:
        command += ["--set", text]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode:
        sys.exit(f"exmesh {' '.join(command[3:])} failed:\n{done.stdout}")
    return dict(json.loads((folder / "runs" / "latest" / "report.json").read_text(encoding="utf-8")))


HEADS = ("scene", "budget", "seconds", "processor s", "load", "used", "clock", *FIGURES.values())


def line(row: dict[str, Any]) -> str:
    """A row of the table; `used` and `clock` are shares of the budget."""
    limit = SECONDS.get(row["budget"])
    shares = ["", ""] if limit is None else [
        f"{row['processor_seconds'] / AT_ONCE / limit:.0%}", f"{row['seconds'] / limit:.0%}"
    ]  # fmt: skip
    figures = ["" if row[key] is None else f"{row[key]:.3g}" for key in FIGURES.values()]
    cells = [
        row["scene"],
        row["budget"],
        f"{row['seconds']:.0f}",
        f"{row['processor_seconds']:.0f}",
        f"{row['load']:.1f}",
    ]
    return "| " + " | ".join([*cells, *shares, *figures]) + " |"


def _spent() -> float:
    """Processor seconds of the processes that this one has waited for, theirs included."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
