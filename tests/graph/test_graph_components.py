"""Components: plugged in by "@name", checked like nodes, part of the key, never steps of their own."""

from __future__ import annotations

from typing import Any

import pytest

from exmesh_graph.graph import Component, NodeDef, param
from exmesh_graph.graph.cache import keys
from exmesh_graph.graph.cache.keys import key_of, preimage_of
from exmesh_graph.graph.declare.components import MAX_NESTING, rebuild
from exmesh_graph.graph.declare.ports import signature
from exmesh_graph.graph.run.job import Job, job_of
from exmesh_graph.report.reasons import component_differences
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Mesh

GRAPH = """
nodes:
  two: {type: toy.const, value: 2}
  line: {type: curve.line, slope: 3}
  both: {type: curve.sum, first: "@line", second: "@sign", scale: 2}
  sign: {type: curve.sign}
  end: {type: toy.evaluate, number: "@two.number", curve: "@both"}
"""


def only(problems: list[Any]) -> Any:
    assert len(problems) == 1, "\n".join(map(str, problems))
    return problems[0]


def key(bench: Any, text: str, *sets: str) -> str:
    bound = bench.check(text, *sets).nodes["end"]
    return key_of(preimage_of(bound, "code", {}, {"number": ("Number", "0" * 64)}))


def test_a_component_plugs_in_and_never_runs(bench: Any, states: Any) -> None:
    record = bench.run(GRAPH)
    assert states(record) == {"two": "done", "end": "done"}
    assert bench.value(record, "end") == 2 * (3 * 2 + 1)
    assert [step.name for step in plan(bench.check(GRAPH), bench.store)] == ["two", "end"]


def test_the_record_shows_components(bench: Any) -> None:
    resolved = bench.run(GRAPH)["resolved"]
    assert resolved["nodes"]["end"]["inputs"] == {"number": "@two.number"}
    assert resolved["nodes"]["end"]["components"] == {"curve": "@both"}
    assert resolved["components"]["both"]["params"] == {"scale": 2.0}
    assert resolved["components"]["both"]["components"]["first"] == {
        "type": "curve.line", "params": {"slope": 3.0, "chunk": 1}, "components": {},
    }  # fmt: skip


def test_golden_key(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    class Fixed:
        digest = "c" * 64

    monkeypatch.setattr(keys, "fingerprint", lambda definition: Fixed)
    preimage = preimage_of(bench.check(GRAPH).nodes["end"], "d" * 64, {}, {"number": ("Number", "1" * 64)})
    rest = {"version": "1", "code": "c" * 64, "libraries": {}}
    line = {"type": "curve.line", "params": {"slope": {"~float": "0x1.8000000000000p+1"}}, "components": {}, **rest}
    sign = {"type": "curve.sign", "params": {}, "components": {}, **rest}
    scale = {"scale": {"~float": "0x1.0000000000000p+1"}}
    both = {"type": "curve.sum", "params": scale, "components": {"first": line, "second": sign}, **rest}
    assert preimage["components"] == {"curve": both}
    assert preimage["inputs"] == {"number": ["Number", "1" * 64]}
    assert key_of(preimage) == "6ed8589690286ea102fb72689e73eba92346f773d1c752389607a6b2c620bdd3"


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ("line.slope=4", False),
        ("both.scale=3", False),
        ("both.second=null", False),
        ("both.first=@sign", False),
        ("line.chunk=7", True),
        ("line.slope=3.0", True),
    ],
)
def test_what_changes_the_key(bench: Any, change: str, same: bool) -> None:
    assert (key(bench, GRAPH) == key(bench, GRAPH, change)) is same


def test_the_name_of_a_component_does_not_matter_and_the_port_does(bench: Any) -> None:
    assert key(bench, GRAPH) == key(bench, GRAPH.replace("line", "straight").replace("curve.straight", "curve.line"))
    one = key(bench, GRAPH + "  f: {type: toy.const}\n", "end.curve=@line", "end.extra=@sign")
    assert one != key(bench, GRAPH, "end.curve=@sign", "end.extra=@line")


def test_code_of_a_component_is_in_the_key(bench: Any) -> None:
    """The sign comes from a helper module: its code counts through the component, not through the node."""
    plugs = preimage_of(bench.check(GRAPH).nodes["end"], "code", {}, {})["components"]["curve"]["components"]
    assert plugs["first"]["code"] != plugs["second"]["code"]
    assert len(plugs["second"]["code"]) == 64


def test_a_changed_component_runs_only_its_users_and_plan_says_why(bench: Any, states: Any) -> None:
    bench.run(GRAPH)
    step = plan(bench.check(GRAPH, "line.slope=4"), bench.store)[1]
    assert (step.name, step.state) == ("end", "run")
    assert step.reason == "component curve.first: parameter slope 3 -> 4"
    assert states(bench.run(GRAPH, "line.slope=4")) == {"two": "hit", "end": "done"}
    assert states(bench.run(GRAPH)) == {"two": "hit", "end": "hit"}


def test_differences_in_words() -> None:
    one = {"type": "a", "version": "1", "code": "x", "params": {"w": 1}, "libraries": {}, "components": {}}
    assert component_differences("loss", {**one, "version": "2", "code": "y", "libraries": {"torch": "2"}}, one) == [
        "component loss: version 1 -> 2",
        "component loss: code changed",
        "component loss: library torch nothing -> 2",
    ]
    assert component_differences("loss", {**one, "type": "b"}, one) == ["component loss is b, was a"]
    assert component_differences("loss", one, None) == ["component loss (a) is newly plugged in"]
    assert component_differences("l", one, {**one, "components": {"in": one}}) == [
        "component l.in (a) is no longer plugged in"
    ]


def test_a_job_carries_components_as_json(bench: Any) -> None:
    graph = bench.check(GRAPH)
    bound = graph.nodes["end"]
    job = job_of(bound, graph, {"inputs": {}}, bench.store, {})
    value = Job.from_json(job.to_json()).bound().components["curve"].value
    assert value == bound.components["curve"].value
    assert type(value) is type(bound.components["curve"].value)
    told = bound.components["curve"].describe()
    assert rebuild("curve", told, bound.where).describe() == told


FED = 'x: {type: toy.evaluate, number: "@two.number"'


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        (FED + ', curve: "@line.value"}', "link", ["is a component", '"@line"']),
        (FED + ', curve: "@none"}', "wrong-type", ["found: NoNoise", "@line"]),
        (FED + ', curve: "@lin"}', "unknown-node", ["no node 'lin'", "@line"]),
        (FED + "}", "missing-port", ["expected: Curve", 'fix: curve: "@component"']),
        (FED + ", curve: curve.line}", "link", ['a link "@component"', "@line"]),
        (
            FED + ', curve: "@two.number"}',
            "wrong-type",
            ["is an artifact, but x.curve takes a component", "expected: Curve", "nearest: @line"],
        ),
        ('x: {type: toy.sign, number: "@two"}', "link", ["names one of its outputs", "@two.number"]),
        ('x: {type: toy.sign, number: "@line"}', "wrong-type", ["takes an artifact", "@two.number"]),
        ("x: {type: curve.line, slope: 11}", "parameter", ["less than or equal to 10", "[per x]"]),
        ("x: {type: curve.line, slop: 1}", "unknown-parameter", ["nearest: slope"]),
        ("x: {type: curve.sum}", "missing-port", ["the input first is not connected"]),
        ('x: {type: curve.sum, first: "@none"}', "wrong-type", ["expected: Curve"]),
        ('x: {type: curve.sum, first: "@x"}', "cycle", ["x <- x"]),
        ("x: {type: curve.lin}", "node-type", ["curve.line"]),
        ("x: {type: curve.line, seed: 3}", "seed", ["a component, which has no seed"]),
    ],
)
def test_one_fault(bench: Any, line: str, code: str, words: list[str]) -> None:
    problem = only(bench.problems(GRAPH + f"  none: {{type: noise.none}}\n  {line}\n"))
    assert problem.code == code
    assert "graph.yaml:9" in str(problem)
    for word in words:
        assert word in str(problem)


def test_a_component_is_no_output(bench: Any) -> None:
    problem = only(bench.problems(GRAPH + 'outputs: {line: "@line"}\n'))
    assert "nothing to publish" in problem.what


def test_both_ends_of_a_component_wire_are_named(bench: Any) -> None:
    text = GRAPH + '  none: {type: noise.none}\n  x: {type: toy.evaluate, number: "@two.number", curve: "@none"}\n'
    problem = only(bench.problems(text))
    assert problem.wire.startswith("none (")
    assert "graph.yaml:8) -> x.curve (" in problem.wire


def test_union_of_components(bench: Any) -> None:
    text = GRAPH + "  none: {type: noise.none}\n"
    assert bench.check(text, "end.extra=@none").nodes["end"].components["extra"].definition.type == "noise.none"
    assert set(bench.check(text, "end.extra=null").nodes["end"].components) == {"curve"}


def test_a_mixed_port_takes_an_artifact_or_a_component(bench: Any, states: Any) -> None:
    text = GRAPH + '  mixed: {type: toy.mixed, item: "@two.number", inner: "@one.number"}\n'
    text += "  one: {type: toy.const}\n  none: {type: noise.none}\n"
    record = bench.run(text)
    assert bench.value(record, "mixed") == 2
    record = bench.run(text, "mixed.item=@line")
    assert bench.value(record, "mixed") == 3 * 1
    assert record["resolved"]["nodes"]["mixed"]["components"] == {"item": "@line"}
    assert record["resolved"]["nodes"]["mixed"]["inputs"] == {"inner": "@one.number"}
    assert only(bench.problems(text, "mixed.item=@none")).expected == "Number | Curve"
    assert only(bench.problems(text, "mixed.item=@two")).nearest == ("@two.number",)


def test_a_component_holds_no_artifact() -> None:
    class Holding(Component):
        item: Component | Mesh

    with pytest.raises(TypeError, match="components only"):
        signature(NodeDef("t", Holding, "1"))


def test_in_repeat_blocks(bench: Any) -> None:
    text = """
nodes:
  two: {type: toy.const, value: 2}
  line: {type: curve.line}
  rounds:
    repeat: 2
    carry: {state: "@two.number", curve: "@line"}
    nodes:
      own: {type: curve.sum, first: "@carry.curve", scale: "${round}", at: {2: {scale: 5}}}
      step: {type: toy.evaluate, number: "@carry.state", curve: "@own"}
    next: {state: "@step.number", curve: "@own"}
  end: {type: toy.evaluate, number: "@rounds.state", curve: "@rounds.curve", extra: "@rounds[1].own"}
"""
    graph = bench.check(text, "line.slope=2", "rounds.own.scale=3")
    assert graph.nodes["rounds[2].step"].components["curve"].value.scale == 3  # --set is stronger than at:
    assert graph.nodes["rounds[2].step"].components["curve"].nested["first"].name == "rounds[1].own"
    assert graph.nodes["end"].components["extra"].name == "rounds[1].own"
    record = bench.run(text, "line.slope=2")
    state = 1 * 2 * 2  # round 1
    state = 5 * (1 * 2 * state)  # round 2
    assert bench.value(record, "end") == 5 * (2 * state) + 2 * state


def test_through_extends(bench: Any) -> None:
    bench.write(GRAPH, "base.yaml")
    graph = bench.check("extends: base.yaml\nnodes: {line: {slope: 5}, sign: {type: curve.line, slope: 6}}")
    nested = graph.nodes["end"].components["curve"].nested
    assert (nested["first"].value.slope, nested["second"].value.slope) == (5, 6)


def chain(count: int) -> str:
    lines = [f'  c{i}: {{type: curve.sum, first: "@c{i - 1}"}}' for i in range(1, count)]
    end = f'end: {{type: toy.evaluate, number: "@two.number", curve: "@c{count - 1}"}}'
    return "\n".join(["nodes:", "  c0: {type: curve.line}", *lines, "  two: {type: toy.const}", "  " + end, ""])


def test_nesting_is_bounded(bench: Any) -> None:
    assert bench.value(bench.run(chain(MAX_NESTING)), "end") == 1.0
    problems = bench.problems(chain(600))
    assert f"nest deeper than {MAX_NESTING}" in problems[0].what
    assert problems[0].where.line == 2 + MAX_NESTING


def test_declarations_that_cannot_be_used_are_refused() -> None:
    from pathlib import Path

    class WithPath(Component):
        path: Path = param(doc="A file.")

    class Clash(Component):
        seed: int = param(0, doc="Taken.")

    class Filled(Component):
        inner: Component = Component()  # its parameters would be in no key

    for cls, word in ((WithPath, "declares no sources"), (Clash, "in use already"), (Filled, "by default")):
        with pytest.raises(TypeError, match=word):
            signature(NodeDef("t", cls, "1"))
