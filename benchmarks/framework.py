"""What the framework costs: a graph of 1000 trivial nodes, start-up, hashing, its size, and its peers on one graph.

    python -m benchmarks.framework                   # about two minutes
    python -m benchmarks.framework --quick           # 200 nodes, fewer repeats
    python -m benchmarks.framework --json out.json

Every node takes no time itself, so all seconds are the framework's. Seconds are the best of --repeats; all rows of a
block are measured in one run, one after the other in turn. Hamilton, pytask, Snakemake and redun are peers where
they are installed, here or for another interpreter: `--peers-python peers/bin/python`, after
`pip install sf-hamilton pytask snakemake redun` there. Run it in the repository's root, on a quiet machine.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.framework_peers import PEERS, TOY, engine
from exmesh_graph.files import sha256_file
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs, load_packs
from exmesh_graph.graph.language.check import check_file
from exmesh_graph.graph.run.plan import plan
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import Runner
from tests.test_architecture import BUDGET, framework_size

ENGINES = ("inline", "local")
NEEDS = ("hamilton", "pytask", "snakemake", "redun")
EDIT = 100  # what the first load gives after the edit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="200 nodes, two repeats, a small file to hash")
    parser.add_argument("--nodes", type=int, help="nodes of the large graphs (default 1000)")
    parser.add_argument("--width", type=int, default=67, help="loads of the peers' graph; it has 3 * width - 1 nodes")
    parser.add_argument("--repeats", type=int, help="default 3")
    parser.add_argument("--peers-python", default=sys.executable, help="the interpreter for which they are installed")
    parser.add_argument("--only", nargs="+", choices=list(BLOCKS), default=list(BLOCKS), help="blocks to measure")
    parser.add_argument("--json", type=Path, help="write the rows here as well")
    args = parser.parse_args()
    args.nodes = args.nodes or (200 if args.quick else 1000)
    args.repeats = args.repeats or (2 if args.quick else 3)

    sys.path.append(str(TOY))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH", ""), str(TOY)]))
    found: dict[str, list[dict[str, Any]]] = {}
    for block in args.only:
        with tempfile.TemporaryDirectory() as folder:
            found[block] = BLOCKS[block](args, Path(folder))
        show(block, found[block])
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def show(title: str, rows: list[dict[str, Any]]) -> None:
    """Print a block as a Markdown table."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    print(f"\n## {title}\n| " + " | ".join(columns) + " |\n|" + " --- |" * len(columns))
    for row in rows:
        cells = [row.get(name, "") for name in columns]
        print("| " + " | ".join(f"{c:.3g}" if isinstance(c, float) else str(c) for c in cells) + " |", flush=True)


def size(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Lines of code: no blank lines, comments or docstrings."""
    sizes = framework_size()
    return [{"room": name, "code lines": n} for name, n in [*sizes.items(), (f"all, of {BUDGET}", sum(sizes.values()))]]


def start(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Whole commands in a process of their own."""
    graph, store = write_graph(folder, "mixed", args.nodes), ["--store", str(folder / "store")]
    runs = ["--runs", str(folder / "runs")]
    run_here(graph, folder / "store", folder / "runs", load_packs())
    commands = {
        "python -c pass": ["-c", "pass"],
        "exmesh --help": [*EXMESH, "--help"],
        f"exmesh check, {args.nodes} nodes": [*EXMESH, "check", str(graph)],
        f"exmesh plan, {args.nodes} hits": [*EXMESH, "plan", str(graph), *store],
        f"exmesh run, {args.nodes} hits, with its report": [*EXMESH, "run", str(graph), *store, *runs],
    }
    best: dict[str, tuple[float, float]] = {}
    for _ in range(args.repeats + 1):
        for name, words in commands.items():
            spent = command_seconds([sys.executable, *words])
            best[name] = min(best.get(name, spent), spent)
    return [{"command": name, "seconds": wall, "CPU seconds": cpu} for name, (wall, cpu) in best.items()]


EXMESH = ["-c", "from exmesh_graph.cli import main; main()"]


def command_seconds(words: list[str]) -> tuple[float, float]:
    """(wall, CPU) seconds of a command that must succeed."""
    before, began = os.times(), time.perf_counter()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    wall, after = time.perf_counter() - began, os.times()
    if done.returncode:
        raise SystemExit(f"{' '.join(words)} failed:\n{done.stdout}{done.stderr}")
    return wall, after.children_user + after.children_system - before.children_user - before.children_system


def large(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """`check`, `plan` and `run` of large graphs within one process."""
    packs = load_packs()
    rows = []
    for shape in ("wide", "deep", "mixed"):
        for backend in ENGINES:
            graph = write_graph(folder, shape, args.nodes)
            row: dict[str, Any] = {"graph": f"{shape}, {args.nodes} nodes", "backend": backend}
            for repeat in range(args.repeats):
                store = folder / f"{shape}-{backend}-{repeat}"
                before = cpu_seconds()
                cold = run_here(graph, store, folder / "runs", packs, backend)
                lower(row, "cold, CPU ms per node", 1000 * (cpu_seconds() - before) / len(cold["nodes"]))
                lower(row, "cold run, s", cold["seconds"])
                lower(row, "cold, ms per node", 1000 * cold["seconds"] / len(cold["nodes"]))
                began = time.perf_counter()
                checked = check_file(graph, [], packs)
                lower(row, "check, s", time.perf_counter() - began)
                began = time.perf_counter()
                states = {step.state for step in plan(checked, Store(store))}
                lower(row, "plan all hits, s", time.perf_counter() - began)
                hits = run_here(graph, store, folder / "runs", packs, backend)
                assert states == {"hit"} == {node["state"] for node in hits["nodes"]}
                lower(row, "run all hits, s", hits["seconds"])
                shutil.rmtree(store)
            rows.append(row)
    return rows


def cpu_seconds() -> float:
    """Of this process and of its children that ended: what a busy machine or a slow disk does not change."""
    return sum(os.times()[:4])


def lower(row: dict[str, Any], name: str, value: float) -> None:
    row[name] = min(row.get(name, value), value)


def run_here(graph: Path, store: Path, runs: Path, packs: Packs, backend: str = "inline") -> dict[str, Any]:
    """The record of a run on a backend."""
    opened, place = Store(store), RunFolder(runs, "large")
    work = Runner(check_file(graph, [], packs), opened, place, lambda event: None, backend=engine(backend, opened))
    try:
        return work.run()
    finally:
        place.close()


def write_graph(folder: Path, shape: str, count: int) -> Path:
    """wide: all nodes read the first; deep: each reads the one before; mixed: each reads one or two before it."""
    dice = random.Random(1)
    lines = ["  n0: {type: toy.const, value: 1}"]
    for i in range(1, count):
        if shape == "mixed" and i % 2:
            a, b = dice.randrange(i), dice.randrange(i)
            lines.append(f'  n{i}: {{type: toy.subtract, a: "@n{a}.number", b: "@n{b}.number"}}')
        else:
            above = {"wide": 0, "deep": i - 1, "mixed": dice.randrange(i)}[shape]
            lines.append(f'  n{i}: {{type: toy.shift, number: "@n{above}.number", by: {i}}}')
    path = folder / f"{shape}.yaml"
    path.write_text("nodes:\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def hashing(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """The store's digest of a file against hashlib over the same bytes in memory and against sha256sum."""
    data, path = os.urandom((32 if args.quick else 256) * 2**20), folder / "data"
    path.write_bytes(data)
    ways: dict[str, Callable[[], object]] = {
        "hashlib.sha256, bytes in memory": lambda: hashlib.sha256(data).hexdigest(),
        "the store's digest of the file": lambda: sha256_file(path),
    }
    tool = shutil.which("sha256sum")
    if tool:
        ways["sha256sum of the file"] = lambda: subprocess.run([tool, str(path)], capture_output=True, check=True)
    best: dict[str, float] = {}
    for _ in range(args.repeats + 1):
        for name, way in ways.items():
            began = time.perf_counter()
            way()
            lower(best, name, time.perf_counter() - began)
    first = min(best.values())
    return [
        {"way": name, "GB/s": len(data) / 1e9 / s, "of the fastest": f"{first / s:.0%}"} for name, s in best.items()
    ]


def peers(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """The same graph in all frameworks: an empty cache, a full one, one edit, each in a fresh process, in turn."""
    there = []
    for name in PEERS:
        look = [args.peers_python, "-c", f"import {name}"]
        if name in NEEDS and subprocess.run(look, capture_output=True, check=False).returncode:
            print(f"{name} is not installed: left out (--peers-python)")
        else:
            there.append(name)
    nodes = 3 * args.width - 1
    rows = {name: {"framework": name, "nodes": nodes} for name in there}
    for repeat in range(args.repeats):
        for name in there:
            place = folder / f"{name.replace(' ', '-')}-{repeat}"
            for kind, ran, first in (("cold", nodes, 0), ("warm", 0, 0), ("one edit", None, EDIT)):
                python = args.peers_python if name in NEEDS else sys.executable
                words = [name, str(place), str(args.width), str(first)]
                command = [python, "-m", "benchmarks.framework_peers", *words]
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
                if "FOUND" not in done.stdout:
                    raise SystemExit(f"{name} failed:\n{done.stdout}{done.stderr}")
                found = json.loads(done.stdout.rpartition("FOUND")[2])
                assert ran is None or found["ran"] == ran, (name, kind, found)
                if ran is None:
                    rows[name]["nodes run after one edit"] = found["ran"]
                seconds = found["build"] + found["run"]
                lower(rows[name], f"{kind}, s", seconds)
                lower(rows[name], f"{kind}, ms per node", 1000 * seconds / nodes)
                lower(rows[name], f"{kind}, whole process, s of CPU", cpu)
    return list(rows.values())


BLOCKS: dict[str, Callable[[argparse.Namespace, Path], list[dict[str, Any]]]] = {
    "size": size,
    "start": start,
    "large": large,
    "hashing": hashing,
    "peers": peers,
}

if __name__ == "__main__":
    main()
