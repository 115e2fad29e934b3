"""Differences between graphs, in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.variants.compare import identities
from exmesh_graph.report.differences import compare, named_in_short, rerun

Patched = Callable[..., Checked]


def words(old: Checked, new: Checked) -> list[str]:
    by_identity = {identity: name for name, identity in identities(new).items()}
    same = {name: by_identity[i] for name, i in identities(old).items() if i in by_identity}
    return compare(old.resolved(), new.resolved(), same).lines()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("patch", "expected"),
    [
        ("{set: a.value, to: 2}", []),
        ("{set: a.value, to: 3}", ["a: value 2 -> 3"]),
        ("{set: five, to: 6}", ["graph parameter five 5 -> 6", "b: value 5 -> 6"]),
        ("{set: rounds.hop.amount, to: 2}", ["rounds.hop (2 rounds): amount 10 -> 2"]),
        ("{set: 'rounds[2].hop.amount', to: 2}", ["rounds[2].hop: amount 10 -> 2"]),
        ("{set: rounds.repeat, to: 4}", ["rounds: 2 -> 4 rounds"]),
        ("{disconnect: start.b}", ["start: b from @b.number -> nothing"]),
        (
            '{connect: end.b, to: "@rounds[2].step.state"}',
            ["end: b from @rounds[1].step.state -> @rounds[2].step.state"],
        ),
        ("{replace: 'rounds[1].hop', type: toy.leap}", ["rounds[1].hop: type toy.step -> toy.leap"]),
        ("{remove: shown}", ["shown: removed (toy.metrics)"]),
        ("{add: {name: c, type: toy.sign, number: '@a.number'}}", ["c: added (toy.sign, number from @a.number)"]),
        ('{connect: outputs.end, to: "@a.number"}', ["output end: @end.number -> @a.number"]),
        ("{set: end.seed, to: 3}", ["end: seed 0 -> 3"]),
        (
            "{bypass: rounds.hop}",
            [
                "rounds.hop (2 rounds): removed (toy.step)",
                "rounds[2].step: state from @rounds[1].hop.state -> @rounds[1].step.state",
                "end: a from @rounds.hop.state -> @rounds.step.state",
            ],
        ),
    ],
)
def test_one_patch_in_words(patched: Patched, patch: str, expected: list[str]) -> None:
    assert words(patched(), patched(patch)) == expected


def test_a_node_under_another_name_is_called_renamed(patched: Patched) -> None:
    new = patched("{add: {name: c, type: toy.const, value: 2}}", '{connect: start.a, to: "@c.number"}', "{remove: a}")
    assert words(patched(), new) == ["a is now called c"]


def test_components_in_words(patched: Patched) -> None:
    text = """
nodes:
  a: {type: toy.const}
  line: {type: curve.line, slope: 3}
  end: {type: toy.evaluate, number: "@a.number", curve: "@line"}
"""
    old = patched(text=text)
    assert words(old, patched("{set: line.slope, to: 4}", text=text)) == ["component line: slope 3 -> 4"]
    new = patched("{add: {name: s, type: curve.sign}}", '{connect: end.curve, to: "@s"}', text=text)
    assert words(old, new) == ["component s: added (curve.sign)", "end: curve from @line -> @s"]


def test_what_runs_again(patched: Patched) -> None:
    again = rerun(identities(patched()), identities(patched("{set: rounds.hop.amount, to: 2}")))
    assert again == ["rounds[1].hop", "rounds[2].step", "rounds[2].hop", "end", "shown"]
    assert named_in_short(again) == "rounds.hop (2 rounds), rounds.step, end, shown"
    assert named_in_short("abcdef", at_most=2) == "a, b and 4 more"


def test_the_wires_that_differ(patched: Patched) -> None:
    old, new = patched(), patched("{disconnect: start.b}")
    found: Any = compare(old.resolved(), new.resolved())
    assert found.wires == {("b", "start"): "removed"}
    assert found.states == {"start": "changed"}
