"""Conditions: what is not there switches off what cannot do without it; a parameter chooses a type."""

from __future__ import annotations

from typing import Any

import pytest

import exmesh_graph as ex
from exmesh_graph.api.planning import why
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.plan import plan

SWITCH = """
params: {value: 5, run_all: true}
run: all
nodes:
  a: {type: toy.const, value: "${value}"}
  m: {type: toy.maybe, number: "@a.number"}
  high: {type: toy.add, a: "@m.above", b: "@a.number"}
  higher: {type: toy.sign, number: "@high.number"}
  low: {type: toy.add, a: "@m.below", b: "@a.number"}
  both: {type: toy.gather, numbers: ["@high.number", "@low.number"]}
  any: {type: toy.counted, count: 3, judge: "@m.below"}
outputs: {both: "@both.number", higher: "@higher.number"}
"""


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [0, 1])
def test_what_is_not_there_switches_its_users_off(bench: Any, states: Any, workers: int) -> None:
    backend = {"backend": Local(1)} if workers else {}
    record = bench.run(SWITCH, **backend)
    off = {name for name, state in states(record).items() if state == "idle"}
    assert off == {"low"}
    assert record["state"] == "done"
    assert bench.value(record, "high") == 10
    told = [event["message"] for event in bench.events if event.get("node") == "low" and event["event"] == "log"]
    assert told == ["not needed: m.below -> low.a carries nothing"]
    other = bench.run(SWITCH, "value=-5")
    assert {name for name, state in states(other).items() if state == "idle"} == {"high", "higher"}
    assert set(other["published"]) == {"both"}  # and nothing where there is nothing
    again = states(bench.run(SWITCH))
    assert {again.pop("low"), *again.values()} == {"idle", "hit"}


def test_plan_says_what_is_not_needed(bench: Any) -> None:
    assert {s.name: s.state for s in plan(bench.check(SWITCH), bench.store)}["low"] == "unknown"
    bench.run(SWITCH)
    steps = {step.name: step for step in plan(bench.check(SWITCH), bench.store)}
    assert {step.state for name, step in steps.items() if name != "low"} == {"hit"}
    assert (steps["low"].state, steps["low"].reason) == ("idle", "not needed: m.below -> low.a carries nothing")
    planned = ex.plan(bench.root / "graph.yaml", store=bench.root / "store")
    assert planned.counts["idle"] == 1
    assert "1 not needed" in str(planned)
    assert why(bench.root / "graph.yaml", "low", store=bench.root / "store").waits_for == ""


def test_a_list_of_what_is_not_there_switches_off_and_a_list_with_gaps_does_not(bench: Any, states: Any) -> None:
    text = """
nodes:
  a: {type: toy.const, value: 2}
  m: {type: toy.maybe, number: "@a.number", limit: 5}
  cut: {type: toy.cut, number: "@m.above"}
  each: {type: toy.sign, each: number, number: "@cut.parts"}
  none: {type: toy.gather, numbers: "@each.number"}
  some: {type: toy.gather, numbers: ["@m.above", "@m.below"]}
"""
    record = bench.run(text)
    assert [name for name, state in states(record).items() if state == "idle"] == ["cut", "each", "none"]
    assert bench.value(record, "some") == 19  # 2, and -1 for `more`


def test_a_run_with_its_report_and_pictures(bench: Any) -> None:
    done = ex.run(bench.write(SWITCH), store=bench.root / "store", runs=bench.root / "runs", workers=0, progress=False)
    assert done.state == "done"
    assert done["low"].number is None
    assert done["low"].info["state"] == "idle"
    assert "not needed" in done.report.read_text()
    assert done.report_error == ""


def test_a_parameter_chooses_the_type(bench: Any, states: Any) -> None:
    text = """
params: {kind: {type: str, default: toy.step, choices: [toy.step, toy.leap]}}
nodes:
  a: {type: toy.const, value: 5}
  n: {type: "${kind}", state: "@a.number"}
"""
    assert bench.check(text).with_idle().nodes["n"].definition.type == "toy.step"
    assert bench.check(text, "kind=toy.leap").with_idle().nodes["n"].definition.type == "toy.leap"
    assert any("one of toy.step, toy.leap" in p.expected for p in bench.problems(text, "kind=toy.sign"))
