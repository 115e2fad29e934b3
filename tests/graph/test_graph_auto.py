"""Parameters that may be `auto`: what decides them must be wired, and the rest of their limits holds."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import pytest

from exmesh_graph.api.schema import schema_text
from exmesh_graph.graph import Context, NodeDef, Params, param
from exmesh_graph.graph.declare.ports import signature
from exmesh_graph.params import Takes
from exmesh_graph.types import SceneNeeds


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


def test_what_a_parameter_takes_must_be_wired_unless_it_is_false(bench: Any) -> None:
    text = 'nodes:\n  j: {type: toy.const, value: 4}\n  x: {type: toy.leaning, judge: "@j.number", lean: LEAN}\n'
    for lean in ("auto", "true"):
        told = problem_of(bench, text.replace("LEAN", lean))
        why = f"x: lean is {lean}, but nothing is wired to ground, which it takes"
        assert f"[link] {why}" in told
        assert "graph.yaml:3" in told
        assert "@j.number" in told
        assert "or say lean: false" in told
        bench.check(text.replace("LEAN", f'{lean}, ground: "@j.number"'))
    bench.check(text.replace("LEAN", "false"))
    bench.check(text.replace(", lean: LEAN", ""))


class Lost(Params):
    lean: Annotated[bool, Takes("sky")] = param(False, doc="Whether to lean on the sky.")


class Found(NamedTuple):
    needs: SceneNeeds


def lost(ctx: Context, ground: SceneNeeds | None = None, *, p: Lost) -> Found:
    raise NotImplementedError


def test_a_port_that_a_parameter_takes_must_be_there() -> None:
    with pytest.raises(TypeError, match="lean goes by sky, which is no optional input"):
        signature(NodeDef("toy.lost", lost, "1"))
