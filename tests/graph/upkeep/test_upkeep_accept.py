"""Accepting code changes: results of the old code count for the new, and for nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.errors import StoreError
from exmesh_graph.graph.cache import fingerprint as fp
from exmesh_graph.graph.cache import keys
from exmesh_graph.graph.cache.accepted import accepted, accepted_between
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run import job, plan, why
from exmesh_graph.graph.upkeep.accept import accept, revoke

GRAPH = """
nodes:
  one: {type: toy.const, value: 1}
  sign: {type: toy.sign, number: "@one.number"}
  sum: {type: toy.add, a: "@sign.number", b: "@one.number"}
"""
Code = Callable[..., None]


@pytest.fixture
def code(monkeypatch: pytest.MonkeyPatch) -> Code:
    """`code(toy__sign="B")` makes the fingerprint of a type another one, as an edit of its helper would."""
    real = fp.fingerprint
    edits: dict[str, str] = {}

    def fake(definition: Any) -> fp.Fingerprint:
        found = real(definition)
        edit = edits.get(definition.type)
        if edit is None:
            return found
        return fp.Fingerprint(edit * 64, {**found.parts, "toy_pack.helpers": edit * 64}, found.modules)

    for module in (plan, job, keys, why):
        monkeypatch.setattr(module, "fingerprint", fake)

    def change(**types: str) -> None:
        edits.update({name.replace("__", "."): edit for name, edit in types.items()})

    return change


def planned(bench: Any, text: str = GRAPH) -> dict[str, str]:
    return {step.name: step.state for step in plan.plan(bench.check(text), bench.store)}


def accept_all(bench: Any, text: str = GRAPH, only: set[str] | None = None) -> dict[str, str]:
    return dict(accept(bench.check(text), bench.store, only))


HITS = {"one": "hit", "sign": "hit", "sum": "hit"}


def test_hits_return(bench: Any, code: Code, states: Any) -> None:
    first = bench.run(GRAPH)
    code(toy__sign="b")
    assert planned(bench) == {"one": "hit", "sign": "run", "sum": "unknown"}
    done = accept_all(bench)
    assert list(done) == ["sign"]
    assert done["sign"].startswith("accepted: ")
    assert "toy_pack.helpers" in done["sign"]
    assert planned(bench) == HITS
    again = bench.run(GRAPH)
    assert states(again) == HITS
    assert [row["key"] for row in again["nodes"]] == [row["key"] for row in first["nodes"]]
    assert accept_all(bench) == {}


def test_it_says_so(bench: Any, code: Code) -> None:
    bench.run(GRAPH)
    code(toy__sign="b")
    accept_all(bench)
    step = plan.plan(bench.check(GRAPH), bench.store)[1]
    assert "accepted" in step.reason
    assert step.preimage is not None
    assert step.action is not None
    (entry,) = accepted_between(bench.store, step.preimage, step.action.preimage)
    assert entry == accepted(bench.store)[0]
    assert entry.parts == ("toy_pack.helpers",)
    assert "@" in entry.who
    assert entry.when > 1e9


def test_another_code_is_still_a_miss(bench: Any, code: Code) -> None:
    bench.run(GRAPH)
    code(toy__sign="b")
    accept_all(bench)
    code(toy__sign="c")
    assert planned(bench)["sign"] == "run"


def test_the_old_code_does_not_use_results_of_the_new(bench: Any, code: Code) -> None:
    other = GRAPH.replace("value: 1", "value: 2")
    bench.run(GRAPH)
    code(toy__sign="b")
    accept_all(bench)
    bench.run(other)
    assert planned(bench, other) == HITS
    code(toy__sign="a")
    assert planned(bench, other)["sign"] == "run"
    code(toy__sign="b")
    (entry,) = accepted(bench.store)
    revoke(bench.store, entry.id[:5])
    assert planned(bench)["sign"] == "run"
    assert planned(bench, other) == HITS


def test_changes_follow_each_other(bench: Any, code: Code) -> None:
    other = GRAPH.replace("value: 1", "value: 2")
    bench.run(GRAPH)
    oldest = bench.store.actions("toy.sign")[0].preimage["code"]
    code(toy__sign="b")
    accept_all(bench)
    bench.run(other)
    code(toy__sign="c")
    accept_all(bench, other)
    assert planned(bench) == HITS
    step = plan.plan(bench.check(GRAPH), bench.store)[1]
    assert step.preimage is not None
    assert step.action is not None
    chain = accepted_between(bench.store, step.preimage, step.action.preimage)
    assert [(entry.new, entry.old) for entry in chain] == [("c" * 64, "b" * 64), ("b" * 64, oldest)]
    revoke(bench.store, chain[1].id)
    assert planned(bench)["sign"] == "run"
    assert planned(bench, other) == HITS


def test_nothing_else_is_crossed(bench: Any, code: Code) -> None:
    bench.run(GRAPH)
    code(toy__add="b", toy__sign="b")
    swapped = GRAPH.replace('a: "@sign.number", b: "@one.number"', 'b: "@sign.number", a: "@one.number"')
    other = swapped.replace("value: 1", "value: 1\n, label: x")
    done = accept_all(bench, GRAPH.replace("value: 1", "value: 3"))
    assert "parameter value: 1 -> 3" in done["one"]
    assert done["sign"] == "not accepted: it waits for one"
    accept_all(bench)
    assert planned(bench) == HITS
    assert planned(bench, swapped)["sum"] == "hit"  # equal numbers, so equal inputs
    assert planned(bench, other)["one"] == "run"
    assert planned(bench, GRAPH.replace("nodes:", "seed: 4\nnodes:"))["sign"] == "unknown"


def test_one_node_at_a_time(bench: Any, code: Code) -> None:
    bench.run(GRAPH)
    code(toy__add="b", toy__sign="b")
    assert accept_all(bench, only={"sum"}) == {"sum": "not accepted: it waits for sign"}
    assert list(accept_all(bench, only={"sign"})) == ["sign"]
    assert planned(bench) == {**HITS, "sum": "run"}


@pytest.mark.parametrize("spoil", [lambda t: t.replace("b", "c"), lambda t: t[:-3], lambda t: ""])
def test_a_spoilt_record_counts_for_nothing(bench: Any, code: Code, spoil: Any) -> None:
    bench.run(GRAPH)
    code(toy__sign="b")
    accept_all(bench)
    (path,) = (bench.root / "store" / "accepted").iterdir()
    path.write_text(spoil(path.read_text()))
    assert planned(bench)["sign"] == "run"
    assert not path.exists()


def test_a_record_under_another_name_counts_for_nothing(bench: Any, code: Code) -> None:
    bench.run(GRAPH)
    code(toy__sign="b")
    accept_all(bench)
    (path,) = (bench.root / "store" / "accepted").iterdir()
    path.rename(path.with_name("0123.json"))
    assert accepted(bench.store) == []


def test_revoke_must_be_told_which(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="names 0 accepted changes"):
        revoke(Store(tmp_path), "")


COMPONENTS = """
nodes:
  one: {type: toy.const, value: 1}
  line: {type: curve.line, slope: 3}
  both: {type: curve.sum, first: "@line", second: "@sign", scale: 2}
  sign: {type: curve.sign}
  end: {type: toy.evaluate, number: "@one.number", curve: "@both"}
"""


def test_code_of_components_can_be_accepted(bench: Any, code: Code) -> None:
    bench.run(COMPONENTS)
    code(curve__line="b", toy__evaluate="d")
    assert planned(bench, COMPONENTS)["end"] == "run"
    assert "slope" in accept_all(bench, COMPONENTS.replace("slope: 3", "slope: 4"))["end"]
    accept_all(bench, COMPONENTS)
    assert planned(bench, COMPONENTS) == {"one": "hit", "end": "hit"}
    assert {entry.type for entry in accepted(bench.store)} == {"curve.line", "toy.evaluate"}
    code(curve__line="c")
    assert planned(bench, COMPONENTS)["end"] == "run"
