"""Sub-graphs: files with named inputs and outputs, used like nodes."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

PART = """
params: {by: 3, times: 2}
inputs: {start: Number, bend: {type: Curve, optional: true, doc: Another curve.}}
nodes:
  line: {type: curve.line, slope: 2}
  first: {type: toy.step, state: "@inputs.start", amount: "${by}"}
  loop:
    repeat: "${times}"
    carry: {state: "@first.state"}
    nodes: {grow: {type: toy.leap, state: "@carry.state", factor: 2}}
    next: {state: "@grow.state"}
  bent: {type: toy.evaluate, number: "@loop.state", curve: "@line", extra: "@inputs.bend"}
outputs: {state: "@loop.state", bent: "@bent.number", curve: "@line", same: "@inputs.start"}
"""

GRAPH = """
nodes:
  one: {type: toy.const}
  sign: {type: curve.sign}
  a: {graph: part.yaml, start: "@one.number"}
  b: {graph: part.yaml, start: "@a.bent", bend: "@sign", by: 10, times: 1}
  end: {type: toy.subtract, a: "@b.state", b: "@a.same"}
outputs: {end: "@end.number"}
run: all
"""


@pytest.fixture
def parts(bench: Any) -> Any:
    bench.write(PART, "part.yaml")
    return bench


def only(problems: list[Any]) -> Any:
    assert len(problems) == 1, "\n".join(map(str, problems))
    return problems[0]


def test_values_flow_through(parts: Any) -> None:
    record = parts.run(GRAPH)
    a = (1 + 3) * 4
    bent = a * 2
    b = (bent + 10) * 2
    assert parts.value(record, "b.bent") == b * 2 + 1
    assert parts.value(record, "end") == b - 1
    names = [row["name"] for row in record["nodes"]]
    assert [name for name in names if name[0] == "b"] == ["b.first", "b.loop[1].grow", "b.bent"]


def test_set_reaches_into_sub_graphs(parts: Any) -> None:
    graph = parts.check(GRAPH, "a.by=5", "b.first.amount=7", "a.loop.repeat=1", "b.line.slope=4", "b.start=@one.number")
    assert graph.nodes["a.first"].params.amount == 5
    assert graph.nodes["b.first"].params.amount == 7
    assert "a.loop[2].grow" not in graph.nodes
    assert graph.nodes["b.bent"].components["curve"].value.slope == 4
    assert str(graph.nodes["b.first"].inputs["state"]) == "@one.number"


def test_equal_uses_share_results(parts: Any, states: Any) -> None:
    """Names and places of use are no part of what a sub-graph makes."""
    use = '{graph: part.yaml, start: "@one.number"}'
    record = parts.run(f"nodes: {{one: {{type: toy.const}}, a: {use}, b: {use}}}")
    keys = {row["name"]: row["key"] for row in record["nodes"]}
    for name in ("first", "loop[1].grow", "loop[2].grow", "bent"):
        assert keys[f"a.{name}"] == keys[f"b.{name}"]
    graph = parts.check(f"nodes: {{one: {{type: toy.const}}, a: {use}}}")
    assert graph.nodes["a.loop[1].grow"].seed != graph.nodes["a.loop[2].grow"].seed


def test_seed_of_a_use(parts: Any) -> None:
    graph = parts.check("seed: 4" + GRAPH, "b.seed=9")
    assert (graph.nodes["a.first"].seed, graph.nodes["b.first"].seed) == (4, 9)


def test_names_inside_do_not_reach_outside_and_the_other_way_round(parts: Any) -> None:
    problem = only(parts.problems(GRAPH, "a.first.state=@one.number"))
    assert "there is no node 'a.one'" in problem.what
    graph = parts.check(GRAPH.replace('b: "@a.same"', 'b: "@a.loop[1].grow.state"'))
    assert str(graph.nodes["end"].inputs["b"]) == "@a.loop[1].grow.state"


def test_components_pass_through_outputs(parts: Any) -> None:
    text = GRAPH.replace("run: all\n", "") + '  x: "@x.number"\n'
    text = text.replace("outputs:", '  x: {type: toy.evaluate, number: "@one.number", curve: "@a.curve"}\noutputs:')
    text = text.replace('outputs: {end: "@end.number"}\n', "outputs:\n")
    assert parts.check(text).nodes["x"].components["curve"].name == "a.line"


def test_in_repeat_blocks(parts: Any) -> None:
    text = """
nodes:
  one: {type: toy.const}
  rounds:
    repeat: 2
    carry: {state: "@one.number"}
    nodes:
      p: {graph: part.yaml, start: "@carry.state", by: "${round}", times: 1, at: {2: {by: 5}}}
    next: {state: "@p.state"}
  end: {type: toy.metrics, number: "@rounds.state"}
run: all
"""
    graph = parts.check(text, "rounds.p.line.slope=3")
    assert graph.nodes["rounds[2].p.bent"].components["curve"].value.slope == 3
    assert graph.nodes["rounds[1].p.first"].params.amount == 1
    assert graph.nodes["rounds[2].p.first"].params.amount == 5
    assert str(graph.nodes["end"].inputs["number"]) == "@rounds[2].p.loop[1].grow.state"
    assert graph.nodes["rounds[1].p.first"].seed != graph.nodes["rounds[2].p.first"].seed


def test_nested(parts: Any) -> None:
    parts.write("""
inputs: {x: Number}
params: {k: 1}
nodes: {deep: {graph: ../part.yaml, start: "@inputs.x", by: "${k}"}}
outputs: {y: "@deep.state"}
""", "inner/mid.yaml")  # fmt: skip
    text = """
nodes:
  one: {type: toy.const}
  m: {graph: inner/mid.yaml, x: "@one.number", k: 8}
  e: {type: toy.metrics, number: "@m.y"}
run: all
"""
    graph = parts.check(text, "m.deep.times=1", "m.deep.first.amount=9")
    assert list(graph.nodes) == ["one", "m.deep.first", "m.deep.loop[1].grow", "m.deep.bent", "e"]
    assert graph.nodes["m.deep.first"].params.amount == 9
    assert parts.check(text).nodes["m.deep.first"].params.amount == 8


def test_through_extends(parts: Any) -> None:
    parts.write(GRAPH, "base.yaml")
    graph = parts.check("""
extends: base.yaml
nodes:
  a: {by: 4, nodes: {first: {amount: 6}, loop: {nodes: {grow: {factor: 5}}}}}
  b: {type: toy.step, state: "@a.state"}
""")
    assert graph.nodes["a.first"].params.amount == 6
    assert graph.nodes["a.loop[2].grow"].params.factor == 5
    assert graph.nodes["b"].definition.type == "toy.step"
    parts.write("extends: base.yaml\nnodes: {a: {nodes: {first: {amount: 6}}}}", "child.yaml")
    child = "nodes: {a: {nodes: {first: {doc: x}, bent: {type: toy.add, a: '@loop.state'}}}}"
    graph = parts.check(f"extends: child.yaml\n{child}")
    assert graph.nodes["a.first"].params.amount == 6


def test_an_input_left_out_is_absent(parts: Any) -> None:
    graph = parts.check(GRAPH)
    assert set(graph.nodes["a.bent"].components) == {"curve"}
    assert set(graph.nodes["b.bent"].components) == {"curve", "extra"}
    problem = only(parts.problems(GRAPH, "a.bent.curve=@inputs.bend"))
    assert problem.code == "link"
    assert "found: nothing" in str(problem)


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ('start: "@one.number"', "by: 3", "missing-port", ["a: the input start", "expected: Number"]),
        ('start: "@one.number"', 'start: "@sign"', "wrong-type", ["graph.yaml:4", "a.start", "found: Sign"]),
        ('start: "@one.number"', 'start: "@one"', "link", ["@one.number"]),
        ('start: "@one.number"', 'start: "@on.number"', "unknown-node", ["graph.yaml:5", "@one.number"]),
        ('bend: "@sign"', 'bned: "@sign"', "unknown-parameter", ["no input or parameter 'bned'", "nearest: bend"]),
        ('bend: "@sign"', 'bend: "@one.number"', "wrong-type", ["takes a component", "@sign"]),
        ("by: 10", 'by: "@sign"', "link", ["is a parameter of the sub-graph"]),
        ("by: 10", "by: x", "param", ["graph.yaml:6", "by cannot be 'x'", "number"]),
        ("by: 10", "seed: -1", "seed", ["b: seed"]),
        ("@b.state", "@b.stat", "unknown-port", ["no output 'stat'", "@b.state"]),
        ("@b.state", "@b", "unknown-port", ["no output ''", "@b.state"]),
        ("graph: part.yaml, start", "graph: parts.yaml, start", "graph", ["no such graph file", "part.yaml"]),
        ("graph: part.yaml, start", "graph: 3, start", "graph", ["names one graph file"]),
        ("by: 10", "nodes: {frist: {amount: 3}}", "extends", ["'frist' has no type", "first"]),
    ],
)
def test_one_fault(parts: Any, old: str, new: str, code: str, words: list[str]) -> None:
    text = GRAPH.replace(old, new, 1)
    problem = parts.problems(text)[0]
    assert problem.code == code
    for word in words:
        assert word in str(problem)


def test_faults_inside_tell_the_file_and_the_place_of_use(parts: Any) -> None:
    parts.write(PART.replace("slope: 2", "slope: 99"), "part.yaml")
    problems = parts.problems(GRAPH)
    assert len(problems) == 2  # each use is another fault: its parameters may differ
    assert "part.yaml:5 (used at " in str(problems[0])
    assert {f"graph.yaml:{line})" in str(problem) for problem, line in zip(problems, (5, 6), strict=True)} == {True}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("start: Number", "start: Numbr", ["no type 'Numbr'", "nearest: Number"]),
        ("start: Number", "start: [Number]", ["not declared as an input is"]),
        ("optional: true", "optonal: true", ["not declared as an input is", "optional: true"]),
        ("start: Number", "by: Number, start: Number", ["both an input and a parameter"]),
        ("@inputs.start", "@inputs.strat", ["no input 'strat'", "nearest: start"]),
    ],
)
def test_faults_of_the_inputs(parts: Any, old: str, new: str, words: list[str]) -> None:
    parts.write(PART.replace(old, new), "part.yaml")
    shown = "\n".join(map(str, parts.problems(GRAPH)))
    for word in words:
        assert word in shown
    assert "used at" in shown


def test_union_and_facets_of_inputs(parts: Any) -> None:
    parts.write("""
inputs: {x: {type: "Whole | Number", facets: {split: train}}}
nodes: {a: {type: toy.add, a: "@inputs.x"}}
outputs: {y: "@a.number"}
""", "part.yaml")  # fmt: skip
    text = """
nodes:
  one: {type: toy.const}
  cut: {type: toy.split, number: "@one.number"}
  p: {graph: part.yaml, x: "@cut.%s"}
"""
    assert set(parts.check(text % "train").nodes) == {"one", "cut", "p.a"}
    problem = only(parts.problems(text % "test"))
    assert (problem.code, problem.nearest[0]) == ("facet", "@cut.train")


def test_a_graph_with_inputs_cannot_run_alone(parts: Any) -> None:
    problem = only(parts.problems(PART.replace(', curve: "@line", same', ", same")))
    assert "can only be used in another" in problem.what
    assert 'start: "@node.port"' in problem.fix


def test_a_missing_file_hides_no_other_fault(parts: Any) -> None:
    text = GRAPH.replace("graph: part.yaml, start", "graph: gone.yaml, start", 1).replace("toy.const", "toy.cnst")
    assert [problem.code for problem in parts.problems(text)] == ["node-type", "graph"]
    assert only(parts.problems("extends: prat.yaml")).nearest[0] == "part.yaml"


def test_files_that_use_each_other(bench: Any) -> None:
    bench.write("nodes: {x: {graph: b.yaml}}", "a.yaml")
    bench.write("nodes: {x: {graph: a.yaml}}", "b.yaml")
    problem = only(bench.problems("nodes: {x: {graph: a.yaml}}"))
    assert "a.yaml -> b.yaml -> a.yaml" in problem.what
    assert "use each other: graph.yaml -> graph.yaml" in only(bench.problems("nodes: {x: {graph: graph.yaml}}")).what


def test_a_value_defined_by_itself(bench: Any) -> None:
    bench.write('inputs: {x: Number}\nnodes: {c: {type: toy.const}}\noutputs: {y: "@inputs.x"}', "pass.yaml")
    problems = bench.problems('nodes: {p: {graph: pass.yaml, x: "@p.y"}, e: {type: toy.sign, number: "@p.y"}}')
    assert any("defined by itself" in problem.what for problem in problems)


@pytest.mark.thorough
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), count=st.integers(1, 6))
def test_a_part_makes_what_its_nodes_make(bench: Any, data: st.DataObject, count: int) -> None:
    """Any run of nodes, cut out into a file of its own: the same values under the same keys."""
    lines = []
    for index in range(count):
        a, b = data.draw(st.lists(st.integers(-1, index - 1), min_size=2, max_size=2))
        kind = data.draw(st.sampled_from(["add", "subtract"]))
        ends = [f"@n{end}.number" if end >= 0 else "@inputs.x" for end in (a, b)]
        lines.append(f'n{index}: {{type: toy.{kind}, a: "{ends[0]}", b: "{ends[1]}"}}')
    body = "\n".join(f"  {line}" for line in lines)
    bench.write(f'inputs: {{x: Number}}\nnodes:\n{body}\noutputs: {{y: "@n{count - 1}.number"}}\n', "cut.yaml")
    flat = body.replace("@inputs.x", "@x.number")
    start, end = "x: {type: toy.const, value: 5}", 'end: {type: toy.sign, number: "%s"}'
    plain = bench.run(f"nodes:\n  {start}\n{flat}\n  {end % f'@n{count - 1}.number'}\n")
    use = 'p: {graph: cut.yaml, x: "@x.number"}'
    parted = bench.run(f"nodes:\n  {start}\n  {use}\n  {end % '@p.y'}\n")
    keys = [{row["name"].removeprefix("p."): row["key"] for row in record["nodes"]} for record in (plain, parted)]
    assert keys[0] == keys[1]
    assert {row["state"] for row in parted["nodes"]} == {"hit"}
