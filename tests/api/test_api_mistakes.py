"""What can go wrong when Python calls: each is an ExmeshError with place, what was expected, found, and the fix."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exmesh_graph as ex
from exmesh_graph.errors import ExmeshError, StoreError
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.types import Mesh


def base() -> tuple[ex.Graph, Any]:
    graph = ex.Graph("g")
    return graph, graph.add("one", "toy.const", value=1)


def run(graph: Any, **options: Any) -> ex.Run:
    return ex.run(graph, workers=0, progress=False, **options)


def gone() -> Any:
    done = run(base()[0])
    shutil.rmtree(".exmesh")
    return done["one"].number


def failed() -> Any:
    graph, one = base()
    graph.add("bad", "toy.fail", number=one, value=5)
    return run(graph)


def lacking() -> Any:
    graph, _ = base()
    graph.add("x", "toy.step", amount=1)
    return ex.check(graph)


def written(name: str, text: str) -> Path:
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def number() -> Any:
    return ex.call("toy.const", value=1).number


# what is done, words of the message, of what was expected, of the fix (one of the two may be empty)
MISTAKES: dict[str, tuple[Callable[[], Any], str, str, str]] = {
    "no such file": (lambda: ex.run("nope.yaml"), "no such graph file", "", ""),
    "no such type": (lambda: base()[0].add("x", "toy.cnst"), "toy.cnst", "toy.const", "exmesh nodes"),
    "no such type, called": (lambda: ex.call("toy.cnst"), "toy.cnst", "toy.const", "exmesh nodes"),
    "no such family": (lambda: base()[0].nodes.toi.const(), "toi.const", "", "exmesh nodes"),
    "no such output": (lambda: base()[1].numbr, "numbr", "number", ""),
    "no such input": (lambda: base()[0].add("x", "toy.step", stat="@one.number"), "stat", "state", "exmesh nodes"),
    "no such parameter": (lambda: base()[0].add("x", "toy.const", vale=1), "vale", "value", "exmesh nodes"),
    "no such graph parameter": (lambda: run(base()[0], vale=1), "vale", "seed", ""),
    "no such setting": (lambda: run(base()[0], set={"on.value": 1}), "'on'", "one.value", ""),
    "no such node": (lambda: run(base()[0], nodes="on"), "no node 'on'", "one", ""),
    "no such variant": (lambda: run(base()[0], variant="v"), "no variant 'v'", "base", "declare variants"),
    "no such backend": (lambda: run(base()[0], backend="moon"), "moon", "local or ray", ""),
    "a value of a wrong type": (lambda: base()[0].add("x", "toy.const", value="x"), "valid number", "", ""),
    "a wire of a wrong type": (
        lambda: (g := base())[0].add("x", "toy.read_folder", files=g[1].number), "does not fit", "Files", "",
    ),
    "a missing input": (lacking, "state", "Number", "@"),
    "a missing argument": (lambda: ex.call("toy.step", amount=1), "not given", "Number", "state=..."),
    "an array for a mesh": (
        lambda: ex.call("init.clean", mesh=np.zeros((5, 3))), "shape (5, 3) and type float64", "Mesh", "Mesh(",
    ),
    "an array of a wrong shape": (
        lambda: ex.call("init.clean", mesh=Mesh(np.zeros((5, 2), np.float32), np.zeros((1, 3), np.int32))),
        "Mesh.vertices", "float32 [V, 3]", "",
    ),
    "an array of a wrong type": (
        lambda: ex.call("init.clean", mesh=Mesh(np.zeros((5, 3)), np.zeros((1, 3), np.int32))),
        "is float64", "float32 [V, 3]", "np.asarray",
    ),
    "a graph's wire for a value": (lambda: ex.call("toy.step", state=base()[1].number, amount=1), "Wire", "Number",
                                   "run[node].port"),
    "an array in a graph": (lambda: base()[0].add("x", "toy.const", value=np.zeros(4)), "shape (4,)", "", ".tolist()"),
    "an artifact in a graph": (lambda: base()[0].add("x", "toy.step", state=number()), "in memory", "", "ex.call"),
    "a node of another graph": (
        lambda: base()[0].add("x", "toy.step", state=base()[1].number, amount=1), "another graph", "", "",
    ),
    "a name twice": (lambda: base()[0].add("one", "toy.const", value=1), "already", "", "set("),
    "a store that is gone": (gone, "the store is gone", "a folder", "run the graph again"),
    "a store that is a file": (lambda: run(base()[0], store=written("s", "")), "not a folder", "", "--store"),
    "a run that failed": (failed, "too small", "", "run again"),
    "no such run": (lambda: ex.open_run("runs/x"), "no run folder", "", "exmesh status"),
    "a broken run": (lambda: ex.open_run(written("r/run.json", "{").parent), "cannot be read", "", "the graph again"),
    "no such node of a run": (lambda: run(base()[0])["on"], "no node 'on'", "one", ""),
    "no such output of a run": (lambda: run(base()[0])["one"].numbr, "numbr", "number", ""),
    "no such figure": (lambda: run(base()[0]).metrics["psnr"], "psnr", "Seconds", ""),
    "no asset": (lambda: run(base()[0]).asset, "asset", "", ""),
    "no such sub-graph": (lambda: (g := base()[0], g.part("p", "p.yaml"), ex.check(g)), "no such graph file", "", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_told(case: str) -> None:
    do, what, expected, fix = MISTAKES[case]
    with pytest.raises(ExmeshError) as caught:
        do()
    error, text = caught.value, str(caught.value)
    assert what in text
    assert expected in text
    assert fix in text
    if isinstance(error, GraphErrors):
        assert all(problem.where.file is not None for problem in error.problems), text  # none is "command line"
    elif not isinstance(error, StoreError):
        assert error.where or error.expected or error.fix
