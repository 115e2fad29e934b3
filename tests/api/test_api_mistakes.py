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


def binary(name: str) -> str:
    Path(name).write_bytes(b"\x89PNG")
    return name


def no_folder() -> Any:
    done = run(base()[0])
    shutil.rmtree("runs")
    return done.metrics


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
    "a run for a graph": (lambda: ex.run(run(base()[0])), "a graph cannot be a Run", "ex.Graph", "graph.yaml"),  # type: ignore[arg-type]
    "a checked graph": (lambda: ex.run(ex.check(base()[0])), "cannot be a Checked", "ex.Graph", "what was checked"),  # type: ignore[arg-type]
    "a mapping for a graph": (lambda: ex.run({"nodes": {}}), "cannot be a dict", "ex.Graph", "g.add"),  # type: ignore[arg-type]
    "a node for a graph": (lambda: ex.plan(base()[1]), "cannot be a Node", "ex.Graph", "nodes="),  # type: ignore[arg-type]
    "a list of graphs": (lambda: ex.check(["a.yaml"]), "cannot be a list", "ex.Graph", "ex.sweep"),  # type: ignore[arg-type]
    "numbers for graphs": (lambda: ex.diff(1, 2), "cannot be 1", "ex.Graph", ""),  # type: ignore[arg-type]
    "a number to sweep": (lambda: ex.sweep(5), "cannot be 5", "ex.Graph", ""),  # type: ignore[arg-type]
    "nothing to sweep": (lambda: ex.sweep(), "no graph", "a graph", ""),
    "nothing to load": (lambda: ex.Graph.load(None), "cannot be None", "ex.Graph", ""),  # type: ignore[arg-type]
    "a graph without nodes": (lambda: run(ex.Graph("g")), "no nodes", "nodes:", ""),
    "a name that is none": (lambda: ex.Graph(3), "cannot be 3", "a text", "ex.Graph.load"),  # type: ignore[arg-type]
    "a folder for a graph": (lambda: ex.run("."), "cannot read", "Is a directory", "a text file"),
    "a picture for a graph": (lambda: ex.run(binary("a.png")), "cannot read", "", "UTF-8"),
    "an input without a name": (
        lambda: (g := base())[0].add("x", "toy.step", g[1].number), "<output one.number> has none", "state=...", "name",
    ),
    "an input without a name, by family": (
        lambda: (g := base())[0].nodes.toy.step(g[1].number), "by name", "state=...", "name",
    ),
    "an input without a name, called": (lambda: ex.call("toy.step", number()), "by name", "state=...", "name"),
    "a parameter without a name": (lambda: base()[0].set("one", {"value": 2}), "a dict has none", "value=...", "name"),
    "a value of what has not run": (lambda: base()[1].number.value, "no value yet", "", 'ex.run(graph)["one"]'),
    "a node as an attribute of a run": (lambda: run(base()[0]).one, "no attribute 'one'", "metrics", 'run["one"]'),
    "a node by its number": (lambda: base()[0][0], "no node '0'", "one", ""),  # type: ignore[index]
    "settings of a wrong type": (lambda: run(base()[0], set=5), "set cannot be 5", "pbr.iterations", ""),
    "nodes of a wrong type": (lambda: run(base()[0], nodes=5), "nodes cannot be 5", "the name of a node", ""),
    "workers of a wrong type": (lambda: ex.run(base()[0], workers="two"), "workers cannot be 'two'", "whole", ""),  # type: ignore[arg-type]
    "workers below none": (lambda: ex.run(base()[0], workers=-1), "workers cannot be -1", "whole number from 0", ""),
    "tokens of a wrong type": (lambda: run(base()[0], tokens={"cpu": "x"}), "the token cpu cannot be 'x'", "{", ""),
    "progress of a wrong type": (lambda: ex.run(base()[0], progress="loud"), "'loud'", '"auto", True', ""),  # type: ignore[arg-type]
    "a listener of a wrong type": (lambda: run(base()[0], listener=5), "listener cannot be 5", "a function", ""),
    "a variant of a wrong type": (lambda: run(base()[0], variant=5), "variant cannot be 5", "the name", ""),
    "a store of a wrong type": (lambda: run(base()[0], store=5), "store cannot be 5", "the path of a folder", ""),
    "runs of a wrong type": (lambda: run(base()[0], runs=5), "runs cannot be 5", "the path of a folder", ""),
    "a session of a wrong type": (lambda: run(base()[0], session=5), "session cannot be 5", "ex.Session", ""),
    "a seed of a wrong type": (lambda: ex.call("toy.const", value=1, seed="a"), "seed cannot be 'a'", "whole", ""),  # type: ignore[arg-type]
    "a mesh of another size": (
        lambda: ex.call("uv.unwrap", mesh=Mesh(np.eye(3, dtype=np.float32) * 40, np.array([[0, 1, 2]], np.int32))),
        "units='unknown'", "units='normalised'", "inside the unit sphere",
    ),
    "a graph saved over a folder": (lambda: base()[0].to_yaml("."), "cannot be", "this is a folder", ""),
    "an input of no type": (lambda: base()[0].input("x", 5), "cannot be 5", "a wire type", ""),
    "no such variant of a sweep": (
        lambda: ex.sweep(base()[0], workers=0, progress=False)["v"], "no variant 'v'", "base", "",
    ),
    "a run folder that is gone": (no_folder, "the run folder is gone", "run.json", "run the graph again"),
}  # fmt: skip


@pytest.mark.thorough
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


def test_what_a_run_takes_for_nodes() -> None:
    graph, one = base()
    graph.add("two", "toy.step", state=one.number, amount=1)
    for nodes in (one, one.number, [one.number], "one", ["@one"]):
        assert [step.name for step in ex.plan(graph, nodes=nodes)] == ["one"]
    assert run(graph)[one].number is not None


def test_a_graph_is_saved_into_a_new_folder() -> None:
    base()[0].to_yaml("new folder/graph of mine.yaml")
    assert [step.name for step in ex.plan("new folder/graph of mine.yaml")] == ["one"]


def plain_arrays() -> dict[str, tuple[Callable[[], Any], str, str]]:
    """What is done with plain arrays, words of the message, of what was expected."""
    import torch

    from exmesh_graph import testing
    from exmesh_graph.geometry.clean import clean_mesh
    from exmesh_graph.geometry.hull import SilhouetteField
    from exmesh_graph.raster import project
    from exmesh_graph.types import Views
    from exmesh_graph.uv.unwrap import unwrap

    v, f = testing.mesh().vertices, testing.mesh().faces
    k, w, points = torch.eye(3), torch.eye(4), torch.from_numpy(v)
    masks = np.ones((2, 8, 8), np.float32)
    flat = Views(
        ["a", "b"], np.ones((2, 8, 8, 3), np.float32), masks, np.zeros((2, 3, 3)), np.zeros((2, 4, 4)), "train"
    )
    return {
        "two coordinates": (lambda: unwrap(v[:, :2], f, 64), "float32 [162, 2]", "float [V, 3]"),
        "faces of floats": (lambda: unwrap(v, f.astype(float), 64), "faces: float64", "int [F, 3]"),
        "quadrangles": (lambda: clean_mesh(v, np.zeros((2, 4), np.int32)), "[2, 4]", "int [F, 3]"),
        "an index outside": (lambda: clean_mesh(v, f + 1), "from 1 to 162", "0 to 161"),
        "an index below": (lambda: unwrap(v, f - 1, 64), "from -1 to 160", "0 to 161"),
        "a list": (lambda: unwrap(v.tolist(), f, 64), "a list", "np.asarray(vertices, np.float32)"),
        "a tensor": (lambda: unwrap(points, f, 64), "torch.float32 [162, 3]", "a numpy array"),  # type: ignore[arg-type]
        "one camera for two masks": (
            lambda: SilhouetteField.from_masks(masks, np.ones((1, 3, 3)), np.ones((2, 4, 4))), "[1, 3, 3]", "same N",
        ),
        "an array to project": (lambda: project(v, k, w), "a ndarray", "torch.from_numpy(vertices)"),  # type: ignore[arg-type]
        "points of the plane": (lambda: project(points[:, :2], k, w), "[162, 2]", "[V, 3]"),
        "cameras the wrong way": (lambda: project(points, w, k), "intrinsics has the shape [4, 4]", "[3, 3]"),
        "a flat camera": (lambda: flat.world_to_camera, "a, b: the camera cannot be inverted", "camera_to_world"),
    }  # fmt: skip


def test_wrong_arrays_are_told_by_the_library() -> None:
    for case, (do, what, expected) in plain_arrays().items():
        with pytest.raises(ExmeshError) as caught:
            do()
        assert what in str(caught.value), case
        assert expected in str(caught.value), case
