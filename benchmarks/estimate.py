"""How long a graph of the paper's length will take on this machine: short trials of its loops, extended to full length.

    python -m benchmarks.estimate graphs/paper.yaml
    python -m benchmarks.estimate graphs/exmeshpp.yaml --set scene=FOLDER/plant --share 0.005
    python -m benchmarks.estimate graphs/paper.yaml --json FILE

Runs the graph's fits (planar Gaussians, Stage I, Stage II) in this process, with `--share` of their iterations (once to
load and compile, once measured) and with three times as many. The seconds between are those of the iterations, the rest
is what a node costs beside them (preparing views, baking). All other nodes are taken as they ran. Stage I begins with
a sphere of as many faces as the graph's coarse start, so that a poor short fit of Gaussians cannot stop the trial, and
grows by the graph's own rounds: pictures, faces and maps have their real sizes. What paper.yaml makes of Gaussians
(depth maps, fusion, cleaning: seconds to a minute) and the scores are not in the sum. Processor seconds of all cores;
the paper's minutes on an RTX A6000 stand beside.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML

#: Node types with a loop, and the stage of the paper's table that they belong to.
LOOPS = {
    "init.pgsr": "start", "init.auto": "start", "stage1.refine": "Stage I", "stage2.fit": "Stage II",
    "stage3.refine": "Stage III", "stage2.retouch": "Stage III",
}  # fmt: skip
PAPER_MINUTES = {"start": 3, "Stage I": 10, "Stage II": 17}
TRIAL = """\
# Written by benchmarks.estimate: the graph below, its Stage I begun with a sphere.
extends: {graph}
name: {name}_trial
nodes:
  trial_ball: {{type: init.sphere, faces: {faces}}}
  atlas: {{mesh: "@trial_ball.mesh"}}
"""


class Row(NamedTuple):
    """A node's processor seconds in the longer trial and at the graph's length, and its iterations there, or 0."""

    node: str
    stage: str
    trial: float
    whole: float
    iterations: int


def main() -> None:
    """Print the estimate of one graph."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimate", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="as for exmesh run")
    parser.add_argument("--share", type=float, default=0.004, help="of the iterations, in the short trials")
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    read = YAML(typ="safe").load
    settings = {name: read(value) for name, value in (text.split("=", 1) for text in options.set)}
    rows = estimate(options.graph, settings, options.share)
    print("\n".join(lines(rows)))
    if options.json:
        options.json.write_text(json.dumps([row._asdict() for row in rows], indent=1) + "\n", encoding="utf-8")


def estimate(graph: Path, settings: Mapping[str, Any] | None = None, share: float = 0.004) -> list[Row]:
    """A row for each node that counts, of the graph at its own length; `settings` as `--set` of exmesh run."""
    import exmesh_graph as ex

    given = dict(settings or {})
    checked = ex.check(graph, set=given)
    loops = {name: node for name, node in checked.nodes.items() if node.definition.type in LOOPS}
    coarse = checked.nodes["coarse"].params.faces
    with tempfile.TemporaryDirectory(prefix="estimate-") as folder:
        trial = Path(folder) / "trial.yaml"
        text = TRIAL.format(graph=graph.resolve(), name=graph.stem, faces=5 * int(coarse) // 2)
        trial.write_text(text, encoding="utf-8")
        taken = []
        for k, times in enumerate((1, 1, 3)):
            short = {f"{name}.iterations": times * _few(node.params, share) for name, node in loops.items()}
            taken.append((_seconds(trial, given | short, Path(folder), k), short))
    _, (first, few), (second, more) = taken
    rows = []
    for name, seconds in second.items():
        node = checked.nodes.get(name)
        if node is None:
            continue
        stage = _stage(name, node.definition.type)
        if name not in loops:
            rows.append(Row(name, stage, seconds, seconds, 0))
            continue
        key = f"{name}.iterations"
        length, gap = _length(node.params), more[key] - few[key]
        rows.append(Row(name, stage, seconds, extended(first[name], second[name], few[key], gap, length), length))
    return rows


def extended(first: float, second: float, few: int, gap: int, length: int) -> float:
    """Seconds of `length` iterations, where `few` took `first` and `few + gap` took `second`.

    Noise can make the longer trial the shorter one: an iteration then costs what it does with nothing beside it.
    """
    each = (second - first) / gap if second > first else second / (few + gap)
    return max(second - each * (few + gap), 0.0) + each * length


def lines(rows: list[Row]) -> list[str]:
    """The table, stages summed up."""
    done = [f"{'node':<22}{'trial [s]':>10}{'iterations':>12}{'whole [s]':>11}"]
    merged: dict[str, Row] = {}
    for row in rows:
        name = row.node if "[" not in row.node else row.node.split("[")[0] + "." + row.node.rsplit(".", 1)[1]
        old = merged.get(name, Row(name, row.stage, 0, 0, 0))
        merged[name] = Row(
            name, row.stage, old.trial + row.trial, old.whole + row.whole, old.iterations + row.iterations
        )
    for row in sorted(merged.values(), key=lambda row: -row.whole):
        if row.whole >= 0.5:
            done.append(f"{row.node:<22}{row.trial:>10.1f}{row.iterations or '':>12}{row.whole:>11.0f}")
    done.append("")
    for stage, paper in PAPER_MINUTES.items():
        minutes = sum(row.whole for row in rows if row.stage == stage) / 60
        done.append(f"{stage:<22}{minutes:>10.1f} min    the paper: {paper} min")
    reshaped = sum(row.whole for row in rows if row.stage == LOOPS["stage3.refine"]) / 60
    if reshaped:
        done.append(f"{LOOPS['stage3.refine']:<22}{reshaped:>10.1f} min    not in the paper")
    done.append(f"{'all':<22}{sum(row.whole for row in rows) / 60:>10.1f} min")
    return done


def _seconds(graph: Path, settings: Mapping[str, Any], folder: Path, k: int) -> dict[str, float]:
    """Processor seconds by node of a run in this process, in a store of its own."""
    import exmesh_graph as ex

    began: dict[str, float] = {}
    taken: dict[str, float] = {}

    def hear(event: Mapping[str, Any]) -> None:
        if event["event"] == "node_started":
            began[event["node"]] = time.process_time()
        elif event["event"] == "node_finished":
            taken[event["node"]] = time.process_time() - began.get(event["node"], time.process_time())

    nodes = ex.check(graph, set=dict(settings)).nodes
    names = [name for name in ("gaussians", "coarse", "settle", "pbr", "reshape", "retouch") if name in nodes]
    if "coarse" in names and nodes["coarse"].definition.type not in LOOPS:
        names.remove("coarse")
    ex.run(
        graph, set=dict(settings), nodes=names, workers=0, store=folder / f"store{k}", runs=folder / "runs",
        listener=hear, report=False, progress=False,
    )  # fmt: skip
    return taken


def _length(params: Any) -> int:
    share = getattr(params, "share", 0)
    return round(share * params.total_iterations) if share else int(params.iterations)


def _few(params: Any, share: float) -> int:
    return max(2, round(share * _length(params)))


def _stage(name: str, kind: str) -> str:
    if kind in LOOPS:
        return LOOPS[kind]
    if name.split("[")[0] == "rounds" or name in ("atlas", "start"):
        return "Stage I"
    if kind.startswith(("transport.", "scene.", "stage2.")):
        return "Stage II"
    return "start"


if __name__ == "__main__":
    main()
