"""Patches on what is no plain node: components, sub-graphs and their inner nodes, one round, and bypass as a word."""

from __future__ import annotations

from typing import Any

import pytest
from patched_graphs import Patched, Refusal, value, wires

from exmesh_graph.graph.language.check import Checked

# --- components

PLUGS = """
name: plugs
nodes:
  a: {type: toy.const, value: 2}
  line: {type: curve.line, slope: 3}
  both: {type: curve.sum, first: "@line"}
  end: {type: toy.evaluate, number: "@a.number", curve: "@both", extra: "@line"}
"""


def plugs(graph: Checked) -> dict[str, str]:
    return {port: plug.name for port, plug in graph.nodes["end"].components.items()}


def test_components_are_patched_like_nodes(patched: Patched) -> None:
    assert plugs(patched('{connect: end.curve, to: "@line"}', "{remove: both}", text=PLUGS))["curve"] == "line"
    assert "extra" not in plugs(patched("{disconnect: end.extra}", text=PLUGS))
    graph = patched("{set: line.slope, to: 4}", '{connect: both.second, to: "@line"}', text=PLUGS)
    assert graph.nodes["end"].components["extra"].params() == {"slope": 4, "chunk": 1}
    assert set(graph.nodes["end"].components["curve"].nested) == {"first", "second"}
    graph = patched("{replace: line, type: curve.sign}", text=PLUGS)
    assert graph.nodes["end"].components["extra"].definition.type == "curve.sign"
    graph = patched("{add: {name: sign, type: curve.sign}}", '{connect: end.curve, to: "@sign"}', text=PLUGS)
    assert plugs(graph)["curve"] == "sign"


def test_what_components_cannot_do_is_refused(refusal: Refusal) -> None:
    assert "through which nothing flows" in refusal("{bypass: both}", text=PLUGS).what
    assert "end.curve" in refusal("{remove: both}", text=PLUGS).what
    assert "is a node, but line is a component" in refusal("{replace: line, type: toy.const}", text=PLUGS).what
    assert "@line" in refusal('{connect: end.curve, to: "@lin"}', text=PLUGS).nearest
    assert "is no wire" in refusal("{insert: {name: x, type: curve.sum}, on: end.curve}", text=PLUGS).what


# --- sub-graphs

PART = """
inputs: {start: Number, other: {type: Number, optional: true}}
params: {by: 2}
nodes:
  first: {type: toy.step, state: "@inputs.start", amount: "${by}"}
  loop:
    repeat: 2
    carry: {state: "@first.state"}
    nodes: {grow: {type: toy.step, state: "@carry.state", at: {2: {amount: 5}}}}
    next: {state: "@grow.state"}
outputs: {end: "@loop.state"}
"""
WHOLE = """
name: whole
nodes:
  one: {type: toy.const, value: 1}
  two: {type: toy.const, value: 2}
  p: {graph: part.yaml, start: "@one.number"}
  q: {graph: part.yaml, start: "@one.number"}
  end: {type: toy.add, a: "@p.end", b: "@q.end"}
"""


@pytest.fixture
def part(bench: Any) -> None:
    bench.write(PART, "part.yaml")


@pytest.mark.usefixtures("part")
def test_set_and_connect_reach_into_one_use_of_a_sub_graph(patched: Patched) -> None:
    graph = patched("{set: p.by, to: 7}", '{connect: q.start, to: "@two.number"}', text=WHOLE)
    assert [value(graph, f"{name}.first", "amount") for name in "pq"] == [7, 2]
    assert wires(graph)["q.first.state"] == "two.number"
    graph = patched("{set: p.loop.grow.amount, to: 9}", "{set: 'q.loop[1].grow.amount', to: 8}", text=WHOLE)
    assert [value(graph, f"p.loop[{r}].grow", "amount") for r in (1, 2)] == [9, 9]
    assert [value(graph, f"q.loop[{r}].grow", "amount") for r in (1, 2)] == [8, 5]
    graph = patched("{set: p.loop.repeat, to: 1}", '{connect: p.loop.grow.state, to: "@first.state"}', text=WHOLE)
    assert "p.loop[2].grow" not in graph.nodes
    assert wires(graph)["p.loop[1].grow.state"] == "p.first.state"
    graph = patched('{connect: end.a, to: "@q.end"}', "{remove: p}", text=WHOLE)
    assert "p.first" not in graph.nodes


@pytest.mark.usefixtures("part")
def test_what_sub_graphs_cannot_do_is_refused(refusal: Refusal) -> None:
    assert "p.by" in refusal("{set: p.bye, to: 7}", text=WHOLE).nearest
    assert "p.start" in refusal('{connect: p.stat, to: "@one.number"}', text=WHOLE).nearest
    assert "p.first.amount" in refusal("{set: p.first.amont, to: 7}", text=WHOLE).nearest
    assert "no node 'firs'" in refusal("{set: p.firs.amount, to: 7}", text=WHOLE).what
    assert "there is no node 'firs'" in refusal("{bypass: p.firs}", text=WHOLE).what
    assert "no such graph file" in refusal("{replace: p, graph: other.yaml}", text=WHOLE).what
    assert "has no output 'end'" in refusal("{replace: p, type: toy.step}", text=WHOLE).what

    assert "end.a" in refusal("{remove: p}", text=WHOLE).what


# --- one round


def test_bypass_in_one_round(patched: Patched) -> None:
    graph = patched("{bypass: 'rounds[1].hop'}")
    assert "rounds[1].hop" not in graph.nodes
    assert wires(graph)["rounds[2].step.state"] == "rounds[1].step.state"
    assert wires(graph)["end.a"] == "rounds[2].hop.state"
    last = patched("{bypass: 'rounds[2].hop'}", '{connect: end.b, to: "@rounds[2].hop.state"}')
    assert (wires(last)["end.a"], wires(last)["end.b"]) == ("rounds[2].step.state", "rounds[2].step.state")
    both = patched("{bypass: 'rounds[2].hop'}", "{bypass: 'rounds[2].step'}")
    assert wires(both)["end.a"] == "rounds[1].hop.state"
    assert set(both.nodes) == set(patched().nodes) - {"rounds[2].hop", "rounds[2].step"}


def test_insert_in_one_round(patched: Patched) -> None:
    for on in ("'rounds[2].hop.state'", "'@rounds[2].step.state'"):
        graph = patched(f"{{insert: {{name: mid, type: toy.step}}, on: {on}}}")
        assert [name for name in graph.nodes if name.endswith("mid")] == ["rounds[2].mid"]
        assert wires(graph)["rounds[2].mid.state"] == "rounds[2].step.state"
        assert wires(graph)["rounds[2].hop.state"] == "rounds[2].mid.state"
        assert wires(graph)["rounds[1].hop.state"] == "rounds[1].step.state"


# --- in a sub-graph, and a whole one


@pytest.mark.usefixtures("part")
def test_bypass_reaches_into_one_use_of_a_sub_graph(patched: Patched) -> None:
    graph = patched("{bypass: p.first}", text=WHOLE)
    assert "p.first" not in graph.nodes
    assert wires(graph)["p.loop[1].grow.state"] == "one.number"
    assert wires(graph)["q.loop[1].grow.state"] == "q.first.state"
    graph = patched("{bypass: p.loop.grow}", "{bypass: 'q.loop[2].grow'}", text=WHOLE)
    assert (wires(graph)["end.a"], wires(graph)["end.b"]) == ("p.first.state", "q.loop[1].grow.state")


@pytest.mark.usefixtures("part")
def test_a_whole_sub_graph_is_bypassed_and_replaced_like_a_node(bench: Any, patched: Patched) -> None:
    graph = patched("{bypass: p}", text=WHOLE)
    assert wires(graph)["end.a"] == "one.number"
    assert not any(name.startswith("p.") for name in graph.nodes)
    graph = patched("{replace: p, type: toy.step, ports: {start: state, end: state}, amount: 3}", text=WHOLE)
    assert (wires(graph)["end.a"], wires(graph)["p.state"]) == ("p.state", "one.number")
    other = "inputs: {start: Number}\nparams: {by: 1}\n"
    other += "nodes: {only: {type: toy.step, state: '@inputs.start', amount: '${by}'}}\n"
    bench.write(other + "outputs: {end: '@only.state'}\n", "other.yaml")
    graph = patched("{replace: p, graph: other.yaml, by: 4}", text=WHOLE)
    assert (wires(graph)["end.a"], wires(graph)["p.only.state"]) == ("p.only.state", "one.number")
    assert value(graph, "p.only", "amount") == 4
    graph = patched("{insert: {name: mid, graph: other.yaml}, on: end.a}", text=WHOLE)
    assert (wires(graph)["end.a"], wires(graph)["mid.only.state"]) == ("mid.only.state", "p.loop[2].grow.state")


@pytest.mark.usefixtures("part")
def test_insert_and_replace_reach_into_one_use_of_a_sub_graph(patched: Patched) -> None:
    graph = patched("{insert: {name: mid, type: toy.step}, on: '@p.first.state'}", text=WHOLE)
    assert (wires(graph)["p.mid.state"], wires(graph)["p.loop[1].grow.state"]) == ("p.first.state", "p.mid.state")
    assert "q.mid" not in graph.nodes
    graph = patched("{insert: {name: mid, type: toy.step}, on: 'p.loop[2].grow.state'}", text=WHOLE)
    assert [name for name in graph.nodes if "mid" in name] == ["p.loop[2].mid"]
    graph = patched("{replace: p.first, type: toy.leap, factor: 3}", "{set: p.loop.grow.amount, to: 9}", text=WHOLE)
    assert (value(graph, "p.first", "factor"), value(graph, "p.loop[1].grow", "amount")) == (3, 9)
    assert graph.nodes["q.first"].definition.type == "toy.step"
    graph = patched("{set: p.by, to: 8}", "{insert: {name: mid, type: toy.step}, on: p.first.state}", text=WHOLE)
    assert value(graph, "p.first", "amount") == 8
    renamed = patched("{replace: p.first, type: toy.sign, ports: {state: number}}", text=WHOLE)
    assert wires(renamed)["p.loop[1].grow.state"] == "p.first.number"


@pytest.mark.usefixtures("part")
def test_a_sub_graph_in_a_sub_graph(bench: Any, patched: Patched) -> None:
    outer = "inputs: {start: Number}\nnodes: {inner: {graph: part.yaml, start: '@inputs.start'}}\n"
    bench.write(outer + "outputs: {end: '@inner.end'}\n", "outer.yaml")
    text = "name: g\nnodes:\n  one: {type: toy.const}\n  o: {graph: outer.yaml, start: '@one.number'}\n"
    text += "  end: {type: toy.step, state: '@o.end'}\n"
    graph = patched("{insert: {name: mid, type: toy.step}, on: '@o.inner.first.state'}", text=text)
    assert wires(graph)["o.inner.loop[1].grow.state"] == "o.inner.mid.state"
    assert wires(patched("{bypass: o.inner}", text=text))["end.state"] == "one.number"


@pytest.mark.usefixtures("part")
def test_one_round_of_a_block_around_a_sub_graph_is_refused_not_taken_for_all(refusal: Refusal) -> None:
    text = """
name: g
nodes:
  one: {type: toy.const}
  rounds:
    repeat: 2
    carry: {state: "@one.number"}
    nodes: {p: {graph: part.yaml, start: "@carry.state"}}
    next: {state: "@p.end"}
"""
    for patch in ("{bypass: 'rounds[2].p.first'}", "{set: 'rounds[2].p.first.amount', to: 5}",
                  "{insert: {name: mid, type: toy.step}, on: '@rounds[2].p.first.state'}"):  # fmt: skip
        assert (
            "there is no node" in refusal(patch, text=text).what
            or "is the output of no node" in refusal(patch, text=text).what
        )


@pytest.mark.parametrize(("first", "second"), [("b", "a"), ("a", "b")])
def test_nodes_that_are_bypassed_in_a_circle_are_a_cycle(bench: Any, first: str, second: str) -> None:
    text = """
nodes:
  a: {type: toy.step, state: "@%s.state", bypass: {state: state}}
  b: {type: toy.step, state: "@%s.state", bypass: {state: state}}
  end: {type: toy.step, state: "@a.state"}
"""
    assert {problem.code for problem in bench.problems(text % (first, second))} == {"cycle"}


def test_bypass_is_a_word_of_graph_files(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.const}
  s: {type: toy.step, state: "@a.number", bypass: %s}
  end: {type: toy.step, state: "@s.state"}
"""
    assert list(bench.check(text % "{state: state}").with_idle().nodes) == ["a", "end"]
    assert list(bench.check(text % "null").with_idle().nodes) == ["a", "s", "end"]
    assert bench.problems(text % "{state: other}")[0].code == "bypass"
    assert "bypassed without its output 'state'" in bench.problems(text % "{}")[0].what


@pytest.mark.usefixtures("part")
def test_add_and_remove_reach_into_one_use_of_a_sub_graph(bench: Any, patched: Patched, refusal: Refusal) -> None:
    bench.write(PART.replace("  loop:", "  spare: {type: toy.step, state: '@first.state'}\n  loop:"), "part.yaml")
    graph = patched("{add: {name: p.mid, type: toy.step, state: '@spare.state', amount: 9}}", text=WHOLE).with_idle()
    assert (wires(graph)["p.mid.state"], value(graph, "p.mid", "amount")) == ("p.spare.state", 9)
    assert "q.mid" not in graph.nodes
    graph = patched("{remove: q.spare}", "{set: q.by, to: 7}", text=WHOLE).with_idle()
    assert "q.spare" not in graph.nodes
    assert "p.spare" in graph.nodes
    assert value(graph, "q.first", "amount") == 7
    inner = patched("{add: {name: p.loop.more, type: toy.step, state: '@grow.state'}}", text=WHOLE).with_idle()
    assert wires(inner)["p.loop[2].more.state"] == "p.loop[2].grow.state"
    assert "outputs.end" in refusal("{remove: p.loop}", text=WHOLE).what
    assert "of one file at a time" in refusal("{remove: [p.spare, q.spare]}", text=WHOLE).what
    assert "already" in refusal("{add: {name: p.first, type: toy.step}}", text=WHOLE).what


def test_a_removed_list_may_be_empty(patched: Patched) -> None:
    assert patched("{remove: []}").nodes.keys() == patched().nodes.keys()
