"""One small graph in this framework and in its peers: `width` loads, a map of each, a reduction by pairs.

    python -m benchmarks.framework_peers ours /tmp/folder 67 0

Runs it once in the folder's cache and prints JSON: seconds to build the graph and to run it (imports apart), how many
nodes ran, and the result. The last word is the value of the first load, for a run after one edit. Every node returns
one number, so the time is the framework's. Hamilton pickles results to files and keeps metadata in SQLite, redun keeps
both in SQLite; in pytask and Snakemake every task writes its number to a text file, which its users read.
`benchmarks.framework` calls this in fresh processes.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

TOY = Path(__file__).parent.parent / "tests" / "graph" / "toy"
Row = tuple[str, str, list[str]]
"""(name, load | map | reduce, the nodes it reads)."""


def dag(width: int) -> list[Row]:
    """The graph: 3 * width - 1 nodes; the last one is the sum of i + 1 over all loads i."""
    rows: list[Row] = [(f"load_{i}", "load", []) for i in range(width)]
    rows += [(f"map_{i}", "map", [f"load_{i}"]) for i in range(width)]
    open_ends = [f"map_{i}" for i in range(width)]
    while len(open_ends) > 1:
        name = f"sum_{len(rows) - 2 * width}"
        rows.append((name, "reduce", open_ends[:2]))
        open_ends = [*open_ends[2:], name]
    return rows


def ours(folder: Path, width: int, first: int, backend: str = "inline") -> dict[str, Any]:
    """Through `check_file` and `Run`, on a store in the folder."""
    sys.path.append(str(TOY))
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.declare.packs import load_packs
    from exmesh_graph.graph.language.check import check_file
    from exmesh_graph.graph.run.rundir import RunFolder
    from exmesh_graph.graph.run.runner import Runner

    lines = []
    for name, kind, above in dag(width):
        if kind == "load":
            lines.append(f"  {name}: {{type: toy.const, value: {value_of(name, first)}}}")
        elif kind == "map":
            lines.append(f'  {name}: {{type: toy.shift, number: "@{above[0]}.number", by: 1}}')
        else:
            lines.append(f'  {name}: {{type: toy.add, a: "@{above[0]}.number", b: "@{above[1]}.number"}}')
    graph = folder / "graph.yaml"
    graph.write_text("nodes:\n" + "\n".join(lines) + "\n")
    packs = load_packs()
    began = time.perf_counter()
    checked = check_file(graph, [], packs)
    built = time.perf_counter()
    store = Store(folder / "store")
    place = RunFolder(folder / "runs", "dag")
    record = Runner(checked, store, place, lambda event: None, backend=engine(backend, store)).run()
    done = time.perf_counter()
    stored = record["nodes"][-1]["outputs"]["number"]
    value = json.loads((store.data(stored["digest"]) / "number.json").read_text())["value"]
    ran = sum(row["state"] == "done" for row in record["nodes"])
    return {"build": built - began, "run": done - built, "ran": ran, "value": float.fromhex(value)}


def engine(backend: str, store: Any) -> Any:
    """inline (this process) or local (two worker processes)."""
    from exmesh_graph.api.runs import backend_of

    return backend_of(0 if backend == "inline" else 2, store)


def value_of(name: str, first: int) -> int:
    """What a load gives."""
    return int(name[5:]) or first


def ours_unsynced(folder: Path, width: int, first: int) -> dict[str, Any]:
    """The same with `fsync` switched off, as in the peers; not something the command line offers."""
    from exmesh_graph import files

    files.sync = lambda path: None  # type: ignore[assignment]
    return ours(folder, width, first)


def hamilton(folder: Path, width: int, first: int) -> dict[str, Any]:
    """Through `Builder().with_cache()`."""
    from hamilton import driver

    lines = ["RAN = []", ""]
    for name, kind, above in dag(width):
        value = str(value_of(name, first)) if kind == "load" else ""
        body = {"load": value, "map": f"{above[0]} + 1" if above else "", "reduce": " + ".join(above)}[kind]
        given = ", ".join(f"{a}: float" for a in above)
        lines += [f"def {name}({given}) -> float:", f"    RAN.append({name!r})", f"    return {body}", "", ""]
    (folder / "hamilton_dag.py").write_text("\n".join(lines))
    sys.path.append(str(folder))
    module = importlib.import_module("hamilton_dag")
    began = time.perf_counter()
    built_driver = driver.Builder().with_modules(module).with_cache(path=folder / "cache").build()
    built = time.perf_counter()
    last = dag(width)[-1][0]
    value = built_driver.execute([last])[last]
    return {"build": built - began, "run": time.perf_counter() - built, "ran": len(module.RAN), "value": value}


def pytask(folder: Path, width: int, first: int) -> dict[str, Any]:
    """Through `pytask.build`; building and running are one call."""
    import pytask as library

    lines = ["from pathlib import Path", "from typing import Annotated", "from pytask import Product, task", ""]
    lines.append(f"HERE = Path({str(folder)!r})")
    for name, kind, above in dag(width):
        given = "".join(f", {'ab'[i]}: Path = HERE / '{a}.txt'" for i, a in enumerate(above))
        body = {
            "load": str(value_of(name, first)) if kind == "load" else "",
            "map": "float(a.read_text()) + 1",
            "reduce": "float(a.read_text()) + float(b.read_text())",
        }
        lines += ["", "", f"def task_{name}(out: Annotated[Path, Product] = HERE / '{name}.txt'{given}):"]
        lines.append(f"    out.write_text(str({body[kind]}))")
    (folder / "task_dag.py").write_text("\n".join(lines) + "\n")
    began = time.perf_counter()
    session = library.build(paths=[folder], verbose=0)
    seconds = time.perf_counter() - began
    ran = sum(report.outcome.name == "SUCCESS" for report in session.execution_reports)
    value = float((folder / f"{dag(width)[-1][0]}.txt").read_text())
    return {"build": 0.0, "run": seconds, "ran": ran, "value": value}


def snakemake(folder: Path, width: int, first: int) -> dict[str, Any]:
    """Through its command line in this process; a rule for each node, by `shell:`, its quickest kind.

    (A rule of Python, `run:`, starts Python and Snakemake anew.)
    """
    from snakemake.cli import main as command

    lines = []
    for name, kind, above in dag(width):
        value = f"    params: value={value_of(name, first)}\n" if kind == "load" else ""
        files = ", ".join(repr(f"{a}.txt") for a in above)
        given = f"    input: {files}\n" if above else ""
        body = {"load": "{params.value}", "map": "$(cat {input}) + 1",
                "reduce": "$(cat {input[0]}) + $(cat {input[1]})"}[kind]  # fmt: skip
        lines.append(
            f"rule {name}:\n{given}    output: '{name}.txt'\n{value}"
            f"    shell: 'echo $(({body})) > {{output}}; echo {name} >> ran.txt'\n"
        )
    last = dag(width)[-1][0]
    (folder / "Snakefile").write_text("\n".join(lines))
    ran = folder / "ran.txt"
    ran.write_text("")
    words = ["--snakefile", str(folder / "Snakefile"), "--directory", str(folder), "--cores", "1", "--quiet", "all"]
    began = time.perf_counter()
    try:
        command([*words, "--", f"{last}.txt"])
    except SystemExit as end:
        if end.code:
            raise
    seconds = time.perf_counter() - began
    value = float((folder / f"{last}.txt").read_text())
    return {"build": 0.0, "run": seconds, "ran": len(ran.read_text().split()), "value": value}


def redun(folder: Path, width: int, first: int) -> dict[str, Any]:
    """Through a `Scheduler` in this process; three tasks that are called with other arguments."""
    from redun import Scheduler, task
    from redun.config import Config

    ran: list[str] = []

    @task(namespace="dag", version="1")
    def load(value: int) -> int:
        ran.append("load")
        return value

    @task(namespace="dag", version="1")
    def shift(a: int) -> int:
        ran.append("map")
        return a + 1

    @task(namespace="dag", version="1")
    def add(a: int, b: int) -> int:
        ran.append("reduce")
        return a + b

    began = time.perf_counter()
    scheduler = Scheduler(config=Config({"backend": {"db_uri": f"sqlite:///{folder}/redun.db"}}))
    scheduler.load()
    calls: dict[str, Any] = {}
    for name, kind, above in dag(width):
        given = [calls[a] for a in above]
        calls[name] = load(value_of(name, first)) if kind == "load" else (shift if kind == "map" else add)(*given)
    built = time.perf_counter()
    value = scheduler.run(calls[dag(width)[-1][0]])
    return {"build": built - began, "run": time.perf_counter() - built, "ran": len(ran), "value": float(value)}


PEERS: dict[str, Callable[[Path, int, int], dict[str, Any]]] = {
    "ours": ours,
    "ours, no fsync": ours_unsynced,
    "hamilton": hamilton,
    "pytask": pytask,
    "snakemake": snakemake,
    "redun": redun,
}


def main() -> None:
    name, folder, width, first = sys.argv[1:]
    Path(folder).mkdir(parents=True, exist_ok=True)
    found = PEERS[name](Path(folder), int(width), int(first))
    expected = int(width) * (int(width) + 1) / 2 + int(first)
    assert found["value"] == expected, (found, expected)
    print("FOUND", json.dumps(found))


if __name__ == "__main__":
    main()
