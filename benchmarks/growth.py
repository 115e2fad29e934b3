"""What grows with the size of a graph and of a store: checks, a run's report, pictures of all nodes, gc.

    python -m benchmarks.growth                        # about ten minutes: 20 000 nodes, 5000 nodes, 100 000 objects
    python -m benchmarks.growth --only gc --objects 100000
    python -m benchmarks.growth --only report --nodes 1250 2500 5000 --shapes rounds mixed

Nodes take no time themselves. Every row is a process of its own: wall and processor seconds, and the largest memory of
the whole process, imports counted. Where there are several sizes the exponent is the slope through the logarithms of
the processor seconds over those of an empty graph: 1 is linear.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.framework import EXMESH, run_here, show, write_graph
from benchmarks.framework_peers import TOY

LIMITS = "nodes=100000 rounds=20000 blocks=100000 kib=16384 values=10000000"
ROUNDS = """
nodes:
  n: {{type: toy.const, value: 1}}
  rounds:
    repeat: {}
    carry: {{state: "@n.number"}}
    nodes:
      a: {{type: toy.add, a: "@carry.state", b: "@n.number"}}
      b: {{type: toy.shift, number: "@a.number", by: 2}}
      c: {{type: toy.subtract, a: "@b.number", b: "@n.number"}}
      d: {{type: toy.shift, number: "@c.number", by: 1}}
    next: {{state: "@d.number"}}
"""
MAP = """
nodes:
  n: {{type: toy.const, value: 0}}
  parts: {{type: toy.cut, number: "@n.number", parts: {}}}
  moved: {{type: toy.shift, each: number, number: "@parts.parts", by: 1}}
"""
REPORT = """
import json, pathlib
from exmesh_graph.report import build_report
folder = pathlib.Path({folder!r})
build_report(folder, json.loads((folder / "run.json").read_text()), lambda digest: None)
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(BLOCKS), default=list(BLOCKS))
    parser.add_argument("--nodes", type=int, nargs="+", default=[1250, 2500, 5000], help="of the runs that are shown")
    parser.add_argument("--checked", type=int, default=20_000, help="nodes that are checked")
    parser.add_argument("--objects", type=int, default=100_000, help="that gc takes away")
    parser.add_argument("--shapes", nargs="+", choices=("rounds", "wide", "deep", "mixed"), default=["rounds", "mixed"])
    args = parser.parse_args()
    sys.path.append(str(TOY))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH", ""), str(TOY)]))
    os.environ["EXMESH_LIMITS"] = LIMITS
    for block in args.only:
        with tempfile.TemporaryDirectory() as folder:
            show(block, list(BLOCKS[block](args, Path(folder))))


def check(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """Graphs of many nodes are checked, and planned where a list has as many elements as a node has found."""
    for shape in ("rounds", "mixed"):
        file = graph(folder, shape, args.checked)
        yield {"what": "check", "graph": f"{args.checked} nodes, {shape}"} | spent([*EXMESH, "check", str(file)])
    file, store = folder / "map.yaml", ["--store", str(folder / "store")]
    file.write_text(MAP.format(args.checked), encoding="utf-8")
    places = [*store, "--runs", str(folder / "runs")]
    yield {"what": "the list is made", "graph": f"{args.checked} elements"} | spent(
        [*EXMESH, "run", str(file), "--until", "parts", *places]
    )
    yield {"what": "plan", "graph": f"each of {args.checked}"} | spent([*EXMESH, "plan", str(file), *store])


def report(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """The page of a run, a warm run with its page, the picture of all its nodes."""
    from exmesh_graph.graph.declare.packs import load_packs

    packs = load_packs()
    for shape in args.shapes:
        seconds: dict[str, list[tuple[int, float]]] = {}
        for count in args.nodes:
            file, store, runs = graph(folder, shape, count), folder / f"{shape}{count}", folder / f"runs{shape}{count}"
            record = run_here(file, store, runs, packs)
            run = runs / record["id"]
            places = ["--store", str(store), "--runs", str(runs)]
            picture = ["show", str(run), "--rounds", "-o", str(folder / "all.svg")]
            for what, words in {
                "report": ["-c", REPORT.format(folder=str(run))],
                "run, all hits, with its report": [*EXMESH, "run", str(file), *places],
                "picture of all nodes": [*EXMESH, *picture],
                "picture, rounds folded": [*EXMESH, *(word for word in picture if word != "--rounds")],
            }.items():
                row = {"what": what, "graph": f"{shape}, {len(record['nodes'])} nodes"} | spent(words)
                seconds.setdefault(what, []).append((len(record["nodes"]), row["CPU s"]))
                yield row
        for what, pairs in seconds.items():
            if len(pairs) > 1:
                (n, a), (m, b) = pairs[-2:]
                yield {"what": what, "graph": shape, "exponent": math.log(b / a) / math.log(m / n)}


def gc(args: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """A store of many small objects that nothing needs: found, and taken out of it and off the disk."""
    from exmesh_graph.graph.cache.keys import artifact_digest
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.sealed import seal_text
    from exmesh_graph.graph.upkeep.collect import delete, survey

    store = Store(folder)
    for number in range(args.objects):
        data = str(number).encode()
        files = {"x.txt": [len(data), hashlib.sha256(data).hexdigest()]}
        digest = artifact_digest("T", files)
        place = store.data(digest)
        place.mkdir(parents=True)
        (place / "x.txt").write_bytes(data)
        note = {"format": 1, "type": "T", "digest": digest, "files": files}
        (place.parent / "artifact.json").write_text(seal_text(note))
        os.utime(place.parent, (1e9, 1e9))
    os.sync()
    began, processor = time.perf_counter(), time.process_time()
    found = survey(store)
    listed, listed_cpu = time.perf_counter() - began, time.process_time() - processor
    gone, left = delete(store, found)
    deleted, deleted_cpu = time.perf_counter() - began, time.process_time() - processor
    assert (len(gone), len(left)) == (args.objects, 0)
    while any((folder / "trash").iterdir()):
        time.sleep(0.05)
    off = time.perf_counter() - began
    yield {"what": "listed", "objects": args.objects, "s": listed, "CPU s": listed_cpu, "MB": found.bytes / 1e6}
    yield {"what": "out of the store", "objects": args.objects, "s": deleted, "CPU s": deleted_cpu}
    yield {"what": "off the disk", "objects": args.objects, "s": off}


def graph(folder: Path, shape: str, count: int) -> Path:
    if shape != "rounds":
        return write_graph(folder, shape, count)
    file = folder / "rounds.yaml"
    file.write_text(ROUNDS.format(count // 4), encoding="utf-8")
    return file


def spent(words: list[str]) -> dict[str, float]:
    """Wall and processor seconds and largest memory of a process that must succeed."""
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout
    told = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(words)} failed:\n{told}")
    wall = time.perf_counter() - began
    return {"s": wall, "CPU s": used.ru_utime + used.ru_stime, "MB": used.ru_maxrss / 1e3}


BLOCKS = {"check": check, "report": report, "gc": gc}

if __name__ == "__main__":
    main()
