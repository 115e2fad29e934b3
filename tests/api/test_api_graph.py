"""Graphs built in Python are those of graph files: same trees, same checks, same keys, both ways."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exmesh_graph as ex
from exmesh_graph.api.opening import checked_graph
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.variants.checked import variant_names
from exmesh_graph.graph.variants.compare import identities
from exmesh_graph.types import Mesh

GRAPHS = Path(__file__).parent.parent.parent / "graphs"
LOOP = """
name: loop
params: {n: {type: int, default: 3, ge: 0, doc: Rounds.}}
nodes:
  one: {type: toy.const, value: 1}
  rounds:
    repeat: "${n}"
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", amount: "${round}"}
      leap: {type: toy.step, state: "@step.state", amount: 0, every: {2: {type: toy.leap, factor: 3}}}
    next: {state: "@leap.state"}
  files: {type: toy.folder, number: "@rounds.state"}
outputs: {asset: "@files.files"}
"""


def told(graph: Any, **options: Any) -> tuple[Any, Any]:
    """What a graph resolves to, but for the text of its path parameters; the identities of its nodes."""
    checked = checked_graph(graph, **options)
    resolved = checked.resolved()
    return {key: value for key, value in resolved.items() if key != "params"}, identities(checked)


def problems(build: Any) -> list[Any]:
    with pytest.raises(GraphErrors) as caught:
        build()
    return list(caught.value.problems)


def test_python_and_yaml_give_the_same_graph(loop: Any, folder: Path) -> None:
    (folder / "loop.yaml").write_text(LOOP)
    assert told(loop()) == told("loop.yaml")
    assert told(loop(), n=5) == told("loop.yaml", set={"n": 5})
    assert told(loop(), set={"rounds.step.amount": 7}) != told("loop.yaml")


def test_written_and_read_again(loop: Any, folder: Path) -> None:
    text = loop().to_yaml("out.yaml")
    assert (folder / "out.yaml").read_text() == text
    assert told("out.yaml") == told(loop()) == told(ex.Graph.load("out.yaml"))
    assert ex.Graph.load("out.yaml").to_yaml() == text


@pytest.mark.thorough
@pytest.mark.parametrize("file", sorted(GRAPHS.rglob("*.yaml")), ids=lambda f: str(f.relative_to(GRAPHS)))
def test_shipped_graphs_survive_python(file: Path, folder: Path) -> None:
    """Loaded, written elsewhere and read again they are the same graph, faults included; and the same when run."""
    graph = ex.Graph.load(file)
    graph.to_yaml("copy.yaml")
    assert variant_names(folder / "copy.yaml") == variant_names(file)
    results: list[Any] = []
    for source in (file, graph, folder / "copy.yaml"):
        try:
            results.append(told(source))
        except GraphErrors as error:
            results.append([(problem.code, problem.what) for problem in error.problems])
    assert results[0] == results[1] == results[2]


def test_components_plug_in_and_nest() -> None:
    graph = ex.Graph("g")
    two = graph.add("two", "toy.const", value=2)
    both = ex.component("curve.sum", first=ex.component("curve.line", slope=2), second=ex.component("curve.sign"))
    at = graph.add("at", "toy.evaluate", number=two, curve=both)
    assert list(graph) == ["two", "at", "at_curve", "at_curve_first", "at_curve_second"]
    assert ex.check(graph).nodes["at"].components["curve"].value.value(3.0) == 7.0
    graph.set(at, curve="curve.sign")
    assert ex.check(graph).nodes["at"].components["curve"].value.value(3.0) == 1.0
    steep = graph.add("steep", "curve.line", slope=5)
    graph.set(at, curve=steep)
    assert ex.check(graph).nodes["at"].components["curve"].name == "steep"
    assert "component" in problems(lambda: steep.value)[0].fix
    assert problems(lambda: graph.set(at, curve=two))[0].code == "link"


def test_families_add_nodes_and_complete() -> None:
    graph = ex.Graph("g")
    a, b = graph.nodes.toy.const(value=1), graph.nodes.toy.const(value=2)
    total = graph.nodes.toy.add(name="total", a=a, b=b)
    assert list(graph) == ["const", "const_2", "total"]
    assert {"toy", "init", "stage1"} <= set(dir(graph.nodes))
    assert "visual_hull" in dir(graph.nodes.init)
    assert dir(total) == ["number"]
    assert "constant" in (graph.nodes.toy.const.__doc__ or "").lower()


def test_a_graph_that_extends_a_file(folder: Path) -> None:
    (folder / "loop.yaml").write_text(LOOP)
    graph = ex.Graph("mine", extends="loop.yaml")
    graph.set("rounds.step", amount=5)
    graph.set("one", value=3)
    graph.remove("files")
    assert list(graph["rounds"]) == ["step", "leap"]
    last = graph.add("last", "toy.step", state=graph["rounds"].state, amount=1)
    graph.output("asset", last.state)
    checked = ex.check(graph)
    assert checked.nodes["rounds[2].step"].params.model_dump()["amount"] == 5
    assert "files" not in checked.nodes
    (folder / "deep").mkdir()
    graph.to_yaml("deep/mine.yaml")
    assert "extends: ../loop.yaml" in (folder / "deep" / "mine.yaml").read_text()
    assert told("deep/mine.yaml") == told(graph)


def test_sub_graphs(folder: Path) -> None:
    part = ex.Graph("part")
    number = part.input("number", "Number")
    by = part.param("by", 1)
    step = part.add("step", "toy.step", state=number, amount=by)
    part.output("state", step.state)
    graph = ex.Graph("g")
    one = graph.add("one", "toy.const", value=1)
    with pytest.raises(GraphErrors, match="lies in a file"):
        graph.part("twice", part)  # type: ignore[arg-type]
    part.to_yaml("part.yaml")
    twice = graph.part("twice", "part.yaml", number=one.number, by=4)
    graph.set("twice.step", seed=3)
    graph.add("after", "toy.step", state=twice.state, amount=1)
    checked = ex.check(graph)
    assert checked.nodes["twice.step"].params.model_dump()["amount"] == 4
    assert checked.nodes["twice.step"].seed == 3


def test_variants_matrix_and_repeats(loop: Any) -> None:
    graph = loop()
    graph.variant("no_leap", {"bypass": "rounds.leap"}, doc="Steps alone.")
    graph.variant("big", {"set": "one.value", "to": 10}, extends="no_leap")
    graph.matrix(variant=["base", "no_leap"], n=[2, 3])
    graph.repeats(2)
    assert "rounds[1].leap" not in ex.check(graph, variant="big").nodes
    graph.to_yaml("v.yaml")
    for name in ("big", "no_leap,n=2"):
        assert told("v.yaml", variant=name) == told(graph, variant=name)


def test_relative_paths_lead_to_the_same_files(folder: Path) -> None:
    (folder / "in").mkdir()
    (folder / "in" / "a.txt").write_text("2")
    graph = ex.Graph("g")
    path = graph.param("path", "in/a.txt", type="path")
    graph.add("a", "toy.file", path=path)
    graph.add("b", "toy.file", path=Path("in/a.txt"))
    (folder / "sub").mkdir()
    graph.to_yaml("sub/g.yaml")
    text = (folder / "sub" / "g.yaml").read_text()
    assert text.count("../in/a.txt") == 2
    assert told("sub/g.yaml") == told(graph)


def test_relative_paths_of_variants_lead_to_the_same_files(folder: Path) -> None:
    """Of nodes and sub-graphs that patches add, and of parameters that they set."""
    (folder / "in").mkdir()
    (folder / "in" / "a.txt").write_text("2")
    (folder / "in" / "b.txt").write_text("3")
    (folder / "in" / "part.yaml").write_text("nodes: {c: {type: toy.file, path: b.txt}}\noutputs: {n: '@c.number'}\n")
    graph = ex.Graph("g")
    graph.add("a", "toy.file", path="in/a.txt")
    graph.variant("node", {"add": {"name": "b", "type": "toy.file", "path": "in/b.txt"}})
    graph.variant("part", {"add": {"name": "b", "graph": "in/part.yaml"}})
    graph.variant("set", {"set": "a.path", "to": "in/b.txt"})
    graph.variant("sets", {"set": {"a.path": "in/b.txt"}})
    (folder / "sub").mkdir()
    text = graph.to_yaml("sub/g.yaml")
    assert (text.count("../in/b.txt"), text.count("../in/part.yaml")) == (3, 1)
    for name in ("node", "part", "set", "sets"):
        assert told("sub/g.yaml", variant=name) == told(graph, variant=name)


def test_faults_are_told_where_they_are_added() -> None:
    graph = ex.Graph("g")
    one = graph.add("one", "toy.const", value=1)
    faults = problems(lambda: graph.add("x", "toy.step", stat=one.number, amount="much", by=1))
    assert {fault.code for fault in faults} == {"unknown-port", "unknown-parameter", "parameter"}
    assert all("test_api_graph.py:" in str(fault.where) for fault in faults)
    assert "x" not in graph
    both = ex.component("curve.sum", first=ex.component("curve.line"), second=ex.component("curve.lin"))
    problems(lambda: graph.add("x", "toy.evaluate", number=one, curve=both))
    assert list(graph) == ["one"]
    problems(lambda: graph.set("one", value=2, vale=1))
    assert ex.check(graph).nodes["one"].params.model_dump()["value"] == 1
    assert problems(lambda: graph.add("x", "toy.stp"))[0].nearest[0] == "toy.step"
    assert problems(lambda: one.numbr)[0].nearest == ("number",)
    assert not hasattr(one, "numbr")
    files = graph.add("files", "toy.folder", number=one)
    (fault,) = problems(lambda: graph.add("y", "toy.step", state=files.files, amount=1))
    assert (fault.code, fault.expected, fault.found) == ("wrong-type", "Number", "Files")
    assert "@one.number" in fault.nearest


def test_wires_stay_in_their_block_and_graph(loop: Any) -> None:
    graph, other = loop(), loop()
    step = graph["rounds.step"]
    assert "inside the repeat block" in problems(lambda: graph.add("z", "toy.step", state=step.state))[0].found
    assert "another graph" in problems(lambda: graph.add("z", "toy.step", state=other["one"].number))[0].found
    rounds = graph["rounds"]
    with rounds.repeat("inner", 2, state=rounds.carry.state) as inner:
        refused = problems(lambda: inner.add("z", "toy.step", state=rounds.carry.state, amount=1))
        assert "carried by rounds" in refused[0].found
        inner.next(state=inner.add("z", "toy.step", state=inner.carry.state, amount="${round}").state)
    assert len([name for name in ex.check(graph).idle if name.endswith("z")]) == 6  # nothing reads them
    assert problems(lambda: graph["rounds"].next(stat=step.state))[0].nearest == ("state",)
    assert problems(lambda: graph["rounds"].carry.stat)[0].nearest == ("state",)
    assert problems(lambda: graph["rounds.stepp"])[0].nearest == ("step",)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.zeros((3, 3)), r"shape \(3, 3\)"),
        (Mesh(np.zeros((3, 3), np.float32), np.zeros((1, 3), np.int32)), "in memory"),
        (object(), "a object"),
        ({1.5: 2}, "1.5"),
    ],
    ids=["array", "artifact", "object", "key"],
)
def test_what_no_graph_can_hold(value: Any, words: str) -> None:
    with pytest.raises(GraphErrors, match=words):
        ex.Graph("g").add("one", "toy.const", value=value)


def test_numbers_of_numpy_and_tuples_are_plain_values() -> None:
    graph = ex.Graph("g")
    graph.add("one", "toy.const", value=np.float32(0.5))
    assert ex.check(graph).nodes["one"].params.model_dump()["value"] == 0.5


def test_names_and_whole_graphs() -> None:
    graph = ex.Graph("g")
    graph.add("one", "toy.const", value=1)
    assert problems(lambda: graph.add("one", "toy.const", value=1))[0].code == "duplicate-key"
    assert problems(lambda: graph.add("a b", "toy.const", value=1))[0].code == "name"
    graph.add("lost", "toy.step", amount=1)
    graph.add("also", "toy.step", state="@nowhere.number", amount=1)
    assert {fault.code for fault in problems(lambda: ex.check(graph))} == {"missing-port", "unknown-node"}


def test_paths_through_symbolic_links_keep_their_meaning(folder: Path) -> None:
    """`link/../data` starts from where the link leads to, which `data` does not."""
    (folder / "far" / "inner").mkdir(parents=True)
    (folder / "far" / "data.txt").write_text("1")
    (folder / "link").symlink_to(folder / "far" / "inner")
    (folder / "g.yaml").write_text("nodes:\n  a: {type: toy.file, path: link/../data.txt}\n")
    (folder / "out").mkdir()
    ex.Graph.load("g.yaml").to_yaml("out/copy.yaml")
    assert told("out/copy.yaml") == told("g.yaml")
