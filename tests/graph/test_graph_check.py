"""Wrong graphs: everything is found at once, with place, both ends, candidates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import pytest
from pydantic import ValidationError

from exmesh_graph.graph import Context, NodeDef, Params, facets, param
from exmesh_graph.graph.declare.ports import signature
from exmesh_graph.graph.language.nodecheck import _whole_unions
from exmesh_graph.types import Metrics

GOOD = """
nodes:
  one: {type: toy.const, value: 2}
  cut: {type: toy.split, number: "@one.number"}
  sum: {type: toy.add, a: "@cut.train", b: "@one.number"}
"""


def only(problems: list[Any]) -> Any:
    assert len(problems) == 1, "\n".join(map(str, problems))
    return problems[0]


def test_good_graph(bench: Any) -> None:
    graph = bench.check(GOOD)
    assert list(graph.nodes) == ["one", "cut", "sum"]
    assert graph.nodes["one"].params.value == 2.0
    assert isinstance(graph.nodes["one"].params.value, float)
    assert graph.needed_for(["cut"]) == {"one", "cut"}


def test_order_follows_wires_not_the_file(bench: Any) -> None:
    graph = bench.check('nodes: {b: {type: toy.add, a: "@a.number"}, a: {type: toy.const}}')
    assert list(graph.nodes) == ["a", "b"]


@pytest.mark.parametrize(
    ("line", "code", "nearest"),
    [
        ("x: {type: toy.cnst}", "node-type", "toy.const"),
        ("x: {type: toy.const, valeu: 3}", "unknown-parameter", "value"),
        ('x: {type: toy.add, a: "@one.number", c: "@one.number"}', "unknown-port", "a"),
        ('x: {type: toy.add, a: "@on.number"}', "unknown-node", "@one.number"),
        ('x: {type: toy.add, a: "@one.numbr"}', "unknown-port", "@one.number"),
        ("x: {type: toy.add}", "missing-port", "@one.number"),
        ("x: {type: toy.add, a: null}", "link", "@one.number"),
        ("x: {type: toy.add, a: 3}", "link", "@one.number"),
        ("x: {type: toy.add, a: [one, 0]}", "link", "@one.number"),
        ("x: {type: toy.add, a: one.number}", "link", "@one.number"),
        ('x: {type: toy.whole_only, number: "@one.number"}', "wrong-type", "@w.number"),
        ('x: {type: toy.train_only, number: "@cut.test"}', "facet", "@cut.train"),
    ],
)
def test_one_fault(bench: Any, line: str, code: str, nearest: str) -> None:
    text = GOOD + f"  w: {{type: toy.whole}}\n  {line}\n"
    problem = only(bench.problems(text))
    assert problem.code == code
    assert nearest in problem.nearest
    assert problem.where.line == 7
    assert "graph.yaml:7" in str(problem)


def test_both_ends_of_the_wire_are_named(bench: Any) -> None:
    text = GOOD + '  x: {type: toy.whole_only,\n      number: "@one.number"}\n'
    problem = only(bench.problems(text))
    assert "one.number" in problem.wire
    assert "graph.yaml:3" in problem.wire
    assert "x.number" in problem.wire
    assert "graph.yaml:7" in problem.wire
    assert (problem.expected, problem.found) == ("Whole", "Number")


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("value: 1001", "less than or equal to 1000"),
        ("value: soon", "valid number"),
        ("value: .nan", "finite"),
        ("threads: 1.5", "integer"),
        ("value: [1]", "valid number"),
        ('value: "@one.number"', "is a parameter"),
    ],
)
def test_parameter_values(bench: Any, line: str, word: str) -> None:
    problem = only(bench.problems(GOOD + f"  x: {{type: toy.const, {line}}}\n"))
    assert word in str(problem)
    assert problem.where.line == 6


def test_range_errors_tell_unit_and_meaning(bench: Any) -> None:
    problem = only(bench.problems(GOOD + "  x: {type: toy.const, value: 5000}\n"))
    assert problem.expected == "The number. [apples]"


class Several(Params):
    size: float | Literal["auto"] = param(1.0, ge=0, doc="Of one type or another.")
    pair: tuple[int, int] | None = param(None, doc="Of one type, or none.")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"size": "lots"}, {("size",): ["a valid number", ", or 'auto'"]}),
        ({"size": -1}, {("size",): ["greater than or equal to 0"]}),
        ({"pair": ["x", "y"]}, {("pair", 0): ["valid integer"], ("pair", 1): ["valid integer"]}),
        ({"size": "lots", "pair": [1, "y"]}, {("size",): ["'auto'"], ("pair", 1): ["valid integer"]}),
    ],
)
def test_a_value_that_is_of_no_type_of_several_is_told_once(given: dict[str, Any], told: Any) -> None:
    with pytest.raises(ValidationError) as caught:
        Several.model_validate(given)
    found = {error["loc"]: error["msg"] for error in _whole_unions(caught.value.errors(), Several)}
    assert list(found) == list(told)
    for place, words in told.items():
        assert all(word in found[place] for word in words), found
        assert found[place].count("Input should be") == 1


@pytest.mark.parametrize("value", [True, False])
def test_truth_is_no_number(value: bool) -> None:
    """Wherever parameters are given: in files, and in Python."""

    class Count(Params):
        count: int = param(1, doc="A number.")
        share: float = param(1.0, doc="Another.")
        on: bool = param(True, doc="Not one.")

    for name in ("count", "share"):
        with pytest.raises(ValidationError, match="not true or false"):
            Count(**{name: value})
    assert Count(on=value).on is value


def test_missing_parameter(bench: Any) -> None:
    assert "path must be given" in str(only(bench.problems("nodes: {x: {type: toy.file}}")))


def test_missing_source_file(bench: Any) -> None:
    problem = only(bench.problems("nodes: {x: {type: toy.file, path: gone.txt}}"))
    assert problem.code == "source"
    assert str(bench.root / "gone.txt") in str(problem)


def test_cycle_is_shown(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.add, a: "@c.number"}
  b: {type: toy.add, a: "@a.number"}
  c: {type: toy.add, a: "@b.number"}
  d: {type: toy.add, a: "@c.number"}
"""
    problem = only(bench.problems(text))
    assert problem.code == "cycle"
    assert "a <- c <- b <- a" in problem.what


def test_cycles_that_share_nothing_are_all_told(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.add, a: "@b.number"}
  b: {type: toy.add, a: "@a.number"}
  c: {type: toy.add, a: "@d.number"}
  d: {type: toy.add, a: "@c.number"}
  e: {type: toy.add, a: "@a.number", b: "@d.number"}
"""
    told = bench.problems(text)
    assert [problem.code for problem in told] == ["cycle", "cycle"]
    assert "a <- b <- a" in told[0].what
    assert "c <- d <- c" in told[1].what
    assert ":3) <- b (" in told[0].wire
    assert "repeat" in told[0].fix


def test_self_loop(bench: Any) -> None:
    assert "a <- a" in only(bench.problems('nodes: {a: {type: toy.add, a: "@a.number"}}')).what


def test_everything_at_once(bench: Any) -> None:
    text = """
title: x
seed: -1
nodes:
  a: {type: toy.cnst}
  b: {type: toy.const, value: 5000, vlue: 2}
  c: {type: toy.add, a: "@nowhere.number", b: "b.number"}
  d: {type: toy.whole_only, number: "@b.number"}
  e: {value: 3}
  f: {type: toy.step, state: "@b.number", every: {2: {amount: 3}}}
  g: 12
  h: {type: toy.file, path: "${nothing}/x"}
outputs: {asset: "@b.files"}
"""
    codes = {problem.code for problem in bench.problems(text)}
    assert codes >= {
        "key", "seed", "node-type", "parameter", "unknown-parameter", "unknown-node", "link", "wrong-type",
        "graph", "repeat", "param", "unknown-port",
    }  # fmt: skip


def test_a_fault_in_all_rounds_is_told_once(bench: Any) -> None:
    text = """
nodes:
  one: {type: toy.const}
  rounds:
    repeat: 10
    carry: {state: "@one.number"}
    nodes: {step: {type: toy.step, state: "@carry.state", amont: 3}}
    next: {state: "@step.state"}
"""
    problem = only(bench.problems(text))
    assert problem.rounds == 10
    assert "(and in 9 more rounds)" in str(problem)


@pytest.mark.parametrize(
    ("carry", "following", "word"),
    [
        ("{state: '@one.number'}", "{}", "'state' is missing in next"),
        ("{}", "{state: '@step.state'}", "'state' is missing in carry"),
        ("{state: '@one.numbr'}", "{state: '@step.state'}", "no output 'numbr'"),
        ("{state: '@one.number'}", "{state: '@step.stat'}", "no output 'stat'"),
        ("{state: one}", "{state: '@step.state'}", "'one' is not a link"),
    ],
)
def test_carry_faults(bench: Any, carry: str, following: str, word: str) -> None:
    text = f"""
nodes:
  one: {{type: toy.const}}
  rounds:
    repeat: 2
    carry: {carry}
    nodes: {{step: {{type: toy.step, state: "@carry.state"}}}}
    next: {following}
  end: {{type: toy.metrics, number: "@rounds.state"}}
"""
    assert any(word in str(problem) for problem in bench.problems(text))


def test_carry_outside_and_unknown_carry(bench: Any) -> None:
    assert "outside a repeat" in str(only(bench.problems('nodes: {a: {type: toy.add, a: "@carry.x"}}')))


def test_replaced_types_drop_only_inherited_parameters(bench: Any) -> None:
    text = """
nodes:
  one: {type: toy.const}
  rounds:
    repeat: 2
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", amount: 3, every: {2: {type: toy.leap%s}}}
    next: {state: "@step.state"}
"""
    graph = bench.check(text % ", factor: 4")
    assert graph.nodes["rounds[2].step"].definition.type == "toy.leap"
    assert str(graph.nodes["rounds[2].step"].inputs["state"]) == "@rounds[1].step.state"
    assert "'amount'" in str(only(bench.problems(text % ", amount: 4")))


def test_optional_input_and_null(bench: Any) -> None:
    graph = bench.check(GOOD + '  x: {type: toy.add, a: "@one.number", b: null}\n')
    assert set(graph.nodes["x"].inputs) == {"a"}


def test_set_can_rewire(bench: Any) -> None:
    graph = bench.check(GOOD, "sum.a=@cut.test", "sum.type=toy.subtract")
    assert str(graph.nodes["sum"].inputs["a"]) == "@cut.test"
    assert graph.nodes["sum"].definition.type == "toy.subtract"
    assert "command line" in str(only(bench.problems(GOOD, "sum.a=@cut.tst")))


class _Out(NamedTuple):
    metrics: Metrics


class _PathParams(Params):
    files: list[Path] = param([], doc="Files.")


def _define(function: Any) -> NodeDef:
    return NodeDef("t", function, "1")


def test_declarations_that_cannot_be_trusted_are_refused() -> None:
    def no_sources(ctx: Context, *, p: _PathParams) -> _Out: ...

    def no_tuple(ctx: Context) -> Metrics: ...

    def no_artifact(ctx: Context, x: int) -> _Out: ...

    def clash(ctx: Context, files: Metrics, *, p: _PathParams) -> _Out: ...

    def reserved(ctx: Context, seed: Metrics) -> _Out: ...

    def bare(ctx: Context, x) -> _Out: ...  # type: ignore[no-untyped-def]

    for function, word in (
        (no_sources, "declares no sources"), (no_tuple, "NamedTuple"), (no_artifact, "not an Artifact"),
        (clash, "in use already"), (reserved, "in use already"), (bare, "no annotation"),
    ):  # fmt: skip
        with pytest.raises(TypeError, match=word):
            signature(_define(function))


def test_ports_are_read_from_annotations() -> None:
    def one(
        ctx: Context,
        a: Annotated[Metrics, facets(x=1)],
        b: Annotated[Metrics, facets(y=2)] | None = None,
        c: Annotated[Metrics | None, facets(z=3)] = None,
    ) -> _Out: ...

    kind = signature(_define(one))
    assert {name: (dict(port.facets), port.optional) for name, port in kind.inputs.items()} == {
        "a": ({"x": 1}, False),
        "b": ({"y": 2}, True),
        "c": ({"z": 3}, True),
    }
    assert list(kind.outputs) == ["metrics"]
    assert kind.params is Params
