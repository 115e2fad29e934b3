"""Typed parameters of graphs."""

from __future__ import annotations

from typing import Any

import pytest

from exmesh_graph.params import param

GRAPH = """
params:
  value: {type: float, default: 2, ge: 0, lt: 10, unit: apples, doc: The value.}
  count: {type: int, default: 1, ge: 1}
  mode: {type: str, default: fast, choices: [fast, slow]}
  plain: 5
  flag: true
  free: {type: any, default: 3}
  text: hello
nodes: {x: {type: toy.const, value: "${value}", label: "${text}"}}
"""


def only(problems: list[Any]) -> Any:
    assert len(problems) == 1, "\n".join(map(str, problems))
    return problems[0]


def test_defaults_and_values(bench: Any) -> None:
    assert bench.check(GRAPH).params["value"] == 2
    graph = bench.check(GRAPH, "value=9.5", "count=2e1", "mode=slow", "plain=0.5", "free=[1]", "plain=null")
    assert graph.params["value"] == 9.5
    assert graph.params["count"] == 20
    assert isinstance(graph.params["count"], int)
    assert graph.params["free"] == [1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("value=10", ["value cannot be 10", "float, >= 0, < 10 [apples]: The value.", "command line"]),
        ("value=-1", ["cannot be -1"]),
        ("value=.nan", ["cannot be nan"]),
        ("value=true", ["cannot be True"]),
        ("count=1.5", ["count cannot be 1.5", "int, >= 1"]),
        ("count=many", ["cannot be 'many'"]),
        ("count=null", ["cannot be None"]),
        ("mode=slwo", ["one of fast, slow", "nearest: slow"]),
        ("plain=many", ["expected: number", "type: any"]),
        ("flag=3", ["expected: bool"]),
    ],
)
def test_wrong_values(bench: Any, change: str, words: list[str]) -> None:
    problem = only(bench.problems(GRAPH, change))
    for word in words:
        assert word in str(problem)


def test_required(bench: Any) -> None:
    text = "params: {v: {type: float, doc: Needed.}}\nnodes: {x: {type: toy.const, value: '${v}'}}"
    problem = bench.problems(text)[0]
    assert "v must be given" in problem.what
    assert problem.fix == "--set v=VALUE"
    assert bench.check(text, "v=3").nodes["x"].params.value == 3


def test_children_keep_the_declaration(bench: Any) -> None:
    bench.write(GRAPH, "base.yaml")
    assert bench.check("extends: base.yaml\nparams: {value: 7}").nodes["x"].params.value == 7
    problem = only(bench.problems("extends: base.yaml\nparams: {value: 70}"))
    assert "graph.yaml:2: [param]" in str(problem)
    assert "(declared at " in problem.expected
    assert problem.expected.endswith("base.yaml:3)")
    assert "< 10" in str(problem)
    child = "extends: base.yaml\nparams: {value: {type: float, default: 70, le: 100}}"
    assert bench.check(child).nodes["x"].params.value == 70


def test_references_are_resolved_before_they_are_judged(bench: Any) -> None:
    text = "params: {a: {type: int, default: '${b}', le: 4}, b: 3}\nnodes: {x: {type: toy.const, value: '${a}'}}"
    assert bench.check(text).params["a"] == 3
    assert "a cannot be 5" in only(bench.problems(text, "b=5")).what


@pytest.mark.parametrize(
    ("declaration", "words"),
    [
        ("{type: itn, default: 3}", ["no type 'itn'", "nearest: int"]),
        ("{type: int, default: 3, gee: 3}", ["no key 'gee'", "nearest: ge"]),
        ("{type: int, default: 3, ge: many}", ["ge takes a number"]),
        ("{type: str, default: x, ge: 3}", ["ge takes a number"]),
        ("{type: str, default: x, choices: x}", ["choices is a list"]),
        ("{type: int, default: 3, ge: 4}", ["a cannot be 3", "int, >= 4"]),
    ],
)
def test_wrong_declarations(bench: Any, declaration: str, words: list[str]) -> None:
    problem = only(bench.problems(f"params: {{a: {declaration}}}\nnodes: {{x: {{type: toy.const}}}}"))
    for word in words:
        assert word in str(problem)


def test_a_mapping_is_still_a_value(bench: Any) -> None:
    assert bench.check("params: {a: {b: 3}}\nnodes: {x: {type: toy.const}}").params["a"] == {"b": 3}


def test_a_limit_that_is_not_known_is_refused() -> None:
    """pydantic would take it and check nothing."""
    with pytest.raises(TypeError, match=r"knows no choices, gte; .* Literal"):
        param(1, gte=0, choices=["a"], doc="How.")
