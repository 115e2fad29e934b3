"""Patches on graphs with components and sub-graphs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.variants.checked import check_variant

PART = """
params: {by: {type: float, default: 3, le: 10}}
inputs: {start: Number}
nodes:
  first: {type: toy.step, state: "@inputs.start", amount: "${by}"}
  loop:
    repeat: 2
    carry: {s: "@first.state"}
    nodes: {grow: {type: toy.leap, state: "@carry.s"}}
    next: {s: "@grow.state"}
outputs: {state: "@loop.s"}
"""

GRAPH = """
params: {n: {type: int, default: 1, ge: 1}}
nodes:
  one: {type: toy.const, value: "${n}"}
  line: {type: curve.line}
  sign: {type: curve.sign}
  a: {graph: part.yaml, start: "@one.number"}
  end: {type: toy.evaluate, number: "@a.state", curve: "@line"}
"""


@pytest.fixture
def patched(tmp_path: Path, packs: Any) -> Any:
    (tmp_path / "part.yaml").write_text(PART)

    def patched(patches: str) -> Any:
        path = tmp_path / "graph.yaml"
        path.write_text(GRAPH + f"variants: {{v: [{patches}]}}\n")
        return check_variant(path, (), packs, "v")

    return patched


def test_components(patched: Any) -> None:
    def curve(patches: str) -> Any:
        return patched(patches).nodes["end"].components["curve"]

    assert curve("{set: line.slope, to: 4}").value.slope == 4
    assert curve('{connect: end.curve, to: "@sign"}').name == "sign"
    assert curve("{replace: line, type: curve.sign}").definition.type == "curve.sign"
    assert curve('{add: {name: more, type: curve.line}}, {connect: end.curve, to: "@more"}').name == "more"
    assert "sign" not in patched("{remove: sign}").components


def test_sub_graphs(patched: Any) -> None:
    assert patched("{set: a.by, to: 4}").nodes["a.first"].params.amount == 4
    assert patched("{set: a.first.amount, to: 7}").nodes["a.first"].params.amount == 7
    graph = patched("{set: {a.loop.grow.factor: 5, a.loop.repeat: 1}}")
    assert graph.nodes["a.loop[1].grow"].params.factor == 5
    assert "a.loop[2].grow" not in graph.nodes
    graph = patched('{insert: {name: x, type: toy.sign}, on: "@a.state"}')
    assert str(graph.nodes["x"].inputs["number"]) == "@a.loop[2].grow.state"
    assert patched("{replace: a, type: toy.step, ports: {start: state}}").nodes["a"].definition.type == "toy.step"


def test_declared_parameters_keep_their_ranges(patched: Any) -> None:
    assert patched("{set: n, to: 5}").nodes["one"].params.value == 5
    for patches, words in (
        ("{set: n, to: 0}", "n cannot be 0"),
        ("{set: a.by, to: 11}", "by cannot be 11"),
        ("{set: a.frist.amount, to: 7}", "first"),
        ("{remove: line}", "links to it"),
    ):
        with pytest.raises(GraphErrors, match=words):
            patched(patches)
