"""Parameters that may be `auto`: what decides them must be wired, and the rest of their limits holds."""

from __future__ import annotations

from typing import Any

from exmesh_graph.api.schema import schema_text
from exmesh_graph.graph.declare.ports import signature


def problem_of(bench: Any, text: str) -> Any:
    problems = bench.problems(text)
    assert len(problems) == 1, "\n".join(map(str, problems))
    return str(problems[0])


def test_auto_without_its_judge_is_found_by_check(bench: Any) -> None:
    text = "nodes:\n  j: {type: toy.const, value: 4}\n  x: {type: toy.counted,\n      count: auto}\n"
    told = problem_of(bench, text)
    for words in ("graph.yaml:4", "x: count is auto, but nothing is wired to judge", "@j.number", "give count a value"):
        assert words in told
    bench.problems(text.replace("count: auto", "count: auto, judge: null"))
    bench.check(text.replace("count: auto", 'count: auto, judge: "@j.number"'))
    bench.check(text.replace("count: auto", "count: 3"))


def test_what_else_stands_for_auto_is_told(bench: Any) -> None:
    told = problem_of(bench, "nodes: {x: {type: toy.counted, count: lots}}")
    assert "unable to parse string as an integer, or auto" in told


def test_auto_of_a_component_needs_the_judge_of_its_node(bench: Any) -> None:
    text = "nodes:\n  j: {type: toy.const, value: 4}\n  c: {type: curve.steep, slope: auto}\n"
    text += '  s: {type: curve.sum, first: "@c"}\n'
    told = problem_of(bench, text + '  x: {type: toy.mixed, item: "@s"}\n')
    for words in ("graph.yaml:3", "c: slope is auto, but nothing is wired to x.inner", 'x.inner: "@node.port"'):
        assert words in told
    bench.check(text + '  x: {type: toy.mixed, item: "@s", inner: "@j.number"}\n')
    bench.check(text.replace("auto", "3") + '  x: {type: toy.mixed, item: "@s"}\n')
    told = problem_of(bench, text + '  x: {type: toy.evaluate, number: "@j.number", curve: "@c"}\n')
    assert "toy.evaluate has no port inner" in told
    assert "fix: give slope a value" in told


def test_other_values_keep_their_limits(bench: Any) -> None:
    for value, words in (("0", "greater than or equal to 1"), ("true", "not true"), ("automatic", "valid integer")):
        assert words in problem_of(bench, f"nodes: {{x: {{type: toy.counted, count: {value}}}}}")
    assert "valid boolean" in problem_of(bench, "nodes: {x: {type: toy.counted, flag: 7}}")


def test_auto_is_part_of_the_key_and_runs(bench: Any) -> None:
    text = 'nodes:\n  j: {type: toy.const, value: 4}\n  x: {type: toy.counted, judge: "@j.number", count: auto}\n'
    record = bench.run(text)
    assert record["state"] == "done"
    assert bench.check(text).resolved()["nodes"]["x"]["params"] == {"count": "auto", "flag": False}


def test_schema_and_declaration(packs: Any) -> None:
    assert '"const": "auto"' in schema_text(packs)
    assert signature(packs.types["toy.counted"]).decided_by() == {"count": "judge", "flag": "judge"}
