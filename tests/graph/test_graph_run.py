"""Runs: hits, early cut-off, contracts, failures, and kill -9 at any moment."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from exmesh_graph.errors import DataError
from exmesh_graph.graph.run.memory import frozen
from exmesh_graph.graph.run.runner import NodeFailed
from exmesh_graph.report.reasons import explained as plan
from exmesh_graph.types import Artifact
from exmesh_graph.types.contents import mark_of

LOOP = """
name: loop
params: {n: 4}
nodes:
  one: {type: toy.const, value: 1}
  rounds:
    repeat: "${n}"
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", amount: "${round}"}
      leap: {type: toy.step, state: "@step.state", amount: 0, every: {2: {type: toy.leap, factor: 3}}}
    next: {state: "@leap.state"}
  files: {type: toy.folder, number: "@rounds.state"}
  back: {type: toy.read_folder, files: "@files.files"}
outputs: {asset: "@files.files", figure: "@back.number"}
"""


def reference(n: int) -> float:
    state = 1.0
    for i in range(1, n + 1):
        state = (state + i) * (3 if i % 2 == 0 else 1)
    return state


def test_values_and_published_files(bench: Any, states: Any) -> None:
    record = bench.run(LOOP)
    assert bench.value(record, "back") == reference(4)
    assert set(states(record).values()) == {"done"}
    folder = bench.root / "runs" / record["id"]
    assert (folder / "number.txt").read_text() == str(reference(4))
    assert (folder / "parts" / "half.txt").exists()
    assert (folder / "figure" / "number.json").exists()
    assert record["published"] == {"asset": "number.txt", "figure": "figure"}
    assert (bench.root / "runs" / "latest").resolve() == folder
    (folder / "number.txt").write_text("mine")  # a copy: the store stays as it was
    assert list(bench.store.verify()) == []


def test_second_run_is_all_hits_with_the_first_run_s_times(bench: Any, states: Any) -> None:
    first = bench.run(LOOP)
    second = bench.run(LOOP)
    assert set(states(second).values()) == {"hit"}
    for a, b in zip(first["nodes"], second["nodes"], strict=True):
        assert (a["key"], a["outputs"], a["seconds"]) == (b["key"], b["outputs"], b["seconds"])


def test_a_changed_round_reruns_only_what_follows(bench: Any, states: Any) -> None:
    bench.run(LOOP)
    found = states(bench.run(LOOP, "rounds[3].step.amount=30"))
    assert [name for name, state in found.items() if state == "done"] == [
        "rounds[3].step", "rounds[3].leap", "rounds[4].step", "rounds[4].leap", "files", "back",
    ]  # fmt: skip
    assert states(bench.run(LOOP, "n=6"))["rounds[4].leap"] == "hit"
    assert set(states(bench.run(LOOP)).values()) == {"hit"}


CUT = """
nodes:
  a: {type: toy.const, value: 5}
  s: {type: toy.sign, number: "@a.number"}
  end: {type: toy.step, state: "@s.number"}
"""


def test_equal_outputs_stop_the_cascade(bench: Any, states: Any) -> None:
    bench.run(CUT)
    assert states(bench.run(CUT, "a.value=6")) == {"a": "done", "s": "done", "end": "hit"}
    assert states(bench.run(CUT, "a.value=-6")) == {"a": "done", "s": "done", "end": "done"}


def test_swapped_inputs_are_no_hit(bench: Any, states: Any) -> None:
    text = """
nodes:
  a: {type: toy.const, value: 5}
  b: {type: toy.const, value: 3}
  d: {type: toy.subtract, a: "@a.number", b: "@b.number"}
"""
    assert bench.value(bench.run(text), "d") == 2
    swapped = bench.run(text, "d.a=@b.number", "d.b=@a.number")
    assert states(swapped) == {"a": "hit", "b": "hit", "d": "done"}
    assert bench.value(swapped, "d") == -2


def test_tuning_is_a_hit_and_seed_is_not(bench: Any, states: Any) -> None:
    text = 'nodes: {a: {type: toy.const, threads: 1}, b: {type: toy.seeded, number: "@a.number"}}'
    assert bench.value(bench.run(text), "b") == 1
    assert set(states(bench.run(text, "a.threads=9")).values()) == {"hit"}
    assert bench.value(bench.run(text, "seed=7"), "b") == 8


def test_changed_source_file_is_a_miss(bench: Any, states: Any) -> None:
    text = "nodes: {a: {type: toy.file, path: data/x.txt}}"
    bench.write("1.5", "data/x.txt")
    assert bench.value(bench.run(text), "a") == 1.5
    bench.write("2.5", "data/x.txt")
    assert bench.value(bench.run(text), "a") == 2.5
    bench.write("1.5", "data/y.txt")
    assert states(bench.run(text, f"a.path={bench.root}/data/y.txt")) == {"a": "hit"}


def test_broken_objects_are_made_again(bench: Any, states: Any) -> None:
    first = bench.run(LOOP)
    rows = {row["name"]: row for row in first["nodes"]}
    one = bench.store.data(rows["one"]["outputs"]["number"]["digest"]) / "number.json"
    one.chmod(0o644)
    one.write_text(one.read_text().replace("1", "2"))  # same size: only the bytes tell
    second = bench.run(LOOP, "rounds[1].step.amount=2")
    assert states(second)["one"] == "done"
    assert bench.value(second, "rounds[1].step", "state") == 3.0
    asset = bench.store.data(rows["files"]["outputs"]["files"]["digest"]) / "files" / "number.txt"
    asset.chmod(0o644)
    asset.write_text("9" * len(asset.read_text()))
    third = bench.run(LOOP)
    assert states(third)["files"] == "done"
    assert (bench.root / "runs" / third["id"] / "number.txt").read_text() == str(reference(4))


def test_force_replaces_the_record(bench: Any, states: Any) -> None:
    bench.run(CUT)
    assert states(bench.run(CUT, force={"s"})) == {"a": "hit", "s": "done", "end": "hit"}


def test_targets(bench: Any, states: Any) -> None:
    graph = bench.check(CUT)
    assert states(bench.run(CUT, targets=graph.needed_for(["s"]))) == {"a": "done", "s": "done"}


@pytest.mark.thorough
def test_memory_is_let_go(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.graph.run.runner import Runner

    sizes = []
    settle = Runner._settle

    def watch(self: Runner, *args: Any) -> None:
        settle(self, *args)
        sizes.append(len(self.backend.memory.values))

    monkeypatch.setattr(Runner, "_settle", watch)
    bench.run(LOOP, "n=20")
    assert max(sizes) == 1
    assert sizes[-1] == 0


def test_facets_not_promised_are_checked_when_it_runs(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.const, value: 5}
  t: {type: toy.split, number: "@a.number"}
  s: {type: toy.sign, number: "@t.test"}
  x: {type: toy.train_only, number: "@s.number"}
"""
    assert bench.value(bench.run(text), "x") == 1.0
    from toy_pack import nodes

    with pytest.raises(NodeFailed, match=r"w\.number -> x\.number"):
        bench.run(text + "  w: {type: toy.test_number}\n", "x.number=@w.number")
    assert nodes.Number(1.0, "test").facets()["split"] == "test"


def test_a_broken_promise_is_the_node_s_fault(bench: Any) -> None:
    text = 'nodes: {a: {type: toy.const}, x: {type: toy.liar, number: "@a.number"}}'
    with pytest.raises(NodeFailed, match="promises train with split='train' but made one with split='test'"):
        bench.run(text)


def test_inputs_changed_in_place_are_noticed(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.const, value: 5}
  s: {type: toy.series, number: "@a.number"}
  x: {type: toy.scribble, series: "@s.series"}
"""
    with pytest.raises(NodeFailed, match="changed its input series in place"):
        bench.run(text)
    record = bench.run(text, targets={"a", "s"})
    series = bench.value(record, "s", "series")
    frozen(series)
    with pytest.raises(ValueError, match="read-only"):
        series.data[0] = 1


@pytest.mark.reliability(
    "a node changes its input in place: array, dict, list, attribute", "it fails by name; nothing recorded"
)
def test_changed_dicts_of_inputs_are_noticed(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.const, value: 5}
  m: {type: toy.metrics, number: "@a.number"}
  x: {type: toy.meddle, metrics: "@m.metrics"}
"""
    with pytest.raises(NodeFailed, match=r"toy\.meddle changed its input metrics in place"):
        bench.run(text)
    record = bench.run(text, targets={"a", "m"})
    assert bench.value(record, "m", "metrics").values == {"value": 5.0}


class Odd(Artifact):
    """A wire type that is no dataclass."""

    def __init__(self) -> None:
        self.rows: list[Any] = [{"a": 1.0, "b": (2, "x", None)}, {3, 4}, np.arange(3.0), np.float32(0.5)]
        self.tensor = torch.zeros(3)
        self.itself = self

    @cached_property
    def late(self) -> int:
        return len(self.rows)


@pytest.mark.parametrize(
    "change",
    [
        lambda odd: odd.rows.append(1), lambda odd: odd.rows[0].update(a=1), lambda odd: odd.rows[0].update(c=None),
        lambda odd: odd.rows[0].update(b=(2, "y", None)), lambda odd: odd.rows[1].add(5),
        lambda odd: odd.rows.reverse(), lambda odd: odd.rows[2].__setitem__(1, -0.0),
        lambda odd: odd.tensor.add_(1), lambda odd: setattr(odd, "more", 1),
        lambda odd: odd.rows.__setitem__(3, np.float32(0.25)), lambda odd: odd.rows[0].pop("b"),
    ],
)  # fmt: skip
def test_marks_see_plain_values_lists_sets_tensors_and_attributes(change: Callable[[Odd], Any]) -> None:
    odd = Odd()
    before = mark_of(odd)
    assert odd.late == 4  # what it caches is no change
    assert mark_of(odd) == before
    change(odd)
    assert mark_of(odd) != before


@pytest.mark.parametrize(
    ("headline", "words"),
    [
        ("5", "headline is int, no list"),
        ("[5]", r"headline\[0\] is int, no mapping"),
        ("[{value: 1}]", r"headline\[0\] has no label"),
        ("[{label: A, value: 1}, {label: B, value: [1]}]", r"headline\[1\] \(B\) has the value \[1\]"),
        ("[{label: A, value: 1, floor: low}]", "a floor or a goal that is no number"),
        ("[{label: A, value: 1, over: [1]}]", "an `over` that does not map names to numbers"),
    ],
)
@pytest.mark.reliability(
    "Metrics with a malformed headline", "the node that made them fails by name, not the report at the end"
)
def test_a_malformed_headline_fails_its_node(bench: Any, headline: str, words: str) -> None:
    with pytest.raises(NodeFailed, match=words) as caught:
        bench.run(f"nodes: {{h: {{type: toy.headline, headline: {headline}}}}}")
    assert caught.value.node == "h"
    assert list(bench.store.verify()) == []


def test_published_outputs_do_not_overwrite_each_other(bench: Any) -> None:
    with pytest.raises(NodeFailed, match="the output parts would overwrite parts"):
        bench.run(LOOP.replace("figure:", "parts:"))


FAIL = """
name: failing
nodes:
  a: {type: toy.const, value: 5}
  x: {type: toy.fail, number: "@a.number", value: 9}
  end: {type: toy.step, state: "@x.number"}
"""


def test_failure_leaves_the_store_whole(bench: Any, states: Any) -> None:
    with pytest.raises(NodeFailed) as caught:
        bench.run(FAIL)
    assert isinstance(caught.value.cause, DataError)
    assert "x: toy: the number is too small" in str(caught.value)
    folder = (bench.root / "runs" / "latest").resolve()
    failure = json.loads((folder / "failure.json").read_text())
    assert failure["node"] == "x"
    assert failure["replay"] == "exmesh run --node x"
    assert "DataError" in failure["traceback"]
    assert set(failure["input_digests"]) == {"number"}
    record = json.loads((folder / "run.json").read_text())
    assert record["state"] == "failed"
    assert {row["name"]: row["state"] for row in record["nodes"]} == {"a": "done", "x": "failed", "end": "waiting"}
    assert list(bench.store.verify()) == []
    assert list((bench.store.root / "work").iterdir()) == []
    assert states(bench.run(FAIL, "x.value=1")) == {"a": "hit", "x": "done", "end": "done"}


def test_warnings_travel_with_the_result(bench: Any) -> None:
    first = bench.run(FAIL, "x.value=1")
    assert next(row for row in first["nodes"] if row["name"] == "x")["warnings"] == ["about to compare"]
    again = bench.run(FAIL, "x.value=1")
    assert next(row for row in again["nodes"] if row["name"] == "x")["warnings"] == ["about to compare"]


def test_events(bench: Any) -> None:
    text = 'nodes: {a: {type: toy.const}, s: {type: toy.slow, number: "@a.number", seconds: 0, steps: 50}}'
    record = bench.run(text)
    lines = (bench.root / "runs" / record["id"] / "events.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in lines]
    assert events[0]["event"] == "run_started"
    assert events[-1]["event"] == "run_finished"
    last = [e for e in events if e["event"] == "progress"][-1]
    assert (last["step"], last["total"], last["loss"]) == (50, 50, 1 / 50)
    assert len([e for e in events if e["event"] == "progress"]) < 10


def test_plan_tells_the_reason(bench: Any) -> None:
    bench.run(LOOP)

    def reasons(*sets: str) -> dict[str, tuple[str, str]]:
        steps = plan(bench.check(LOOP, *sets), bench.store)
        return {step.name: (step.state, step.reason) for step in steps}

    assert {state for state, _ in reasons().values()} == {"hit"}
    found = reasons("rounds[2].step.amount=7")
    assert found["rounds[1].leap"][0] == "hit"
    assert found["rounds[2].step"] == ("run", "parameter amount: 2 -> 7")
    assert found["rounds[2].leap"] == ("unknown", "waits for rounds[2].step")


def test_a_plan_says_what_a_run_does(bench: Any, states: Any) -> None:
    bench.run(CUT)
    steps = {s.name: s.state for s in plan(bench.check(CUT, "a.value=6"), bench.store)}
    done = states(bench.run(CUT, "a.value=6"))
    assert steps == {"a": "run", "s": "unknown", "end": "unknown"}
    assert done["a"] == "done"


@pytest.mark.thorough
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), count=st.integers(2, 7))
def test_random_graphs(bench: Any, states: Any, data: st.DataObject, count: int) -> None:
    """A graph's values equal direct evaluation; a change reruns at most what lies below it; a rerun is all hits."""
    lines, parents = [], {}
    for i in range(count):
        if i == 0 or data.draw(st.booleans()):
            lines.append(f"  n{i}: {{type: toy.const, value: {data.draw(st.integers(-5, 5))}}}")
            parents[i] = []
        else:
            a, b = data.draw(st.integers(0, i - 1)), data.draw(st.integers(0, i - 1))
            lines.append(f'  n{i}: {{type: toy.subtract, a: "@n{a}.number", b: "@n{b}.number"}}')
            parents[i] = [a, b]
    order = data.draw(st.permutations(lines))
    text = "nodes:\n" + "\n".join(order) + "\n"
    first = bench.run(text)
    values: dict[int, float] = {}
    for i, line in enumerate(lines):
        if parents[i]:
            values[i] = values[parents[i][0]] - values[parents[i][1]]
        else:
            values[i] = float(line.split("value: ")[1].rstrip("}"))
        assert bench.value(first, f"n{i}") == values[i]
    assert set(states(bench.run(text)).values()) == {"hit"}
    below = {0}
    for i in range(1, count):
        if below & set(parents[i]):
            below.add(i)
    changed = states(bench.run(text, "n0.value=77.5"))
    assert {name for name, state in changed.items() if state == "done"} <= {f"n{i}" for i in below}


KILLER = """
import os, signal, sys
sys.path[:0] = [{toy!r}]
left = {count}
def arm(module, name):
    real = getattr(module, name)
    def call(*args, **kwargs):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*args, **kwargs)
    setattr(module, name, call)
from pathlib import Path
from exmesh_graph.graph.language.check import check_file
from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.run.runner import Runner
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.cache.store import Store
graph = check_file(Path({file!r}), [], load_packs())
for name in ("rename", "replace", "fsync"):
    arm(os, name)
arm(Path, "write_text")
Runner(graph, Store(Path({store!r})), RunFolder(Path({runs!r}), "k"), lambda event: None).run()
print("unharmed", {count} - left)
"""


@pytest.mark.slow
def test_kill_9_at_any_write(bench: Any, states: Any) -> None:
    """Killed before the n-th write, rename or sync: the store never serves anything wrong, the next run ends right."""
    toy = str(Path(__file__).parent / "toy")
    path = bench.write(LOOP)
    killed = 0
    for index, count in enumerate([2, 9, 11, 12, 13, 14, 31]):
        store, runs = bench.root / f"s{index}", bench.root / f"r{index}"
        code = KILLER.format(toy=toy, count=count, file=str(path), store=str(store), runs=str(runs))
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert done.returncode == -signal.SIGKILL, done.stderr
        killed += 1
        bench_store = type(bench.store)(store)
        assert list(bench_store.verify()) == []
        graph = bench.check(LOOP)
        from exmesh_graph.graph.run.rundir import RunFolder
        from exmesh_graph.graph.run.runner import Runner

        folder = RunFolder(runs, "k")
        record = Runner(graph, bench_store, folder, lambda event: None).run()
        folder.close()
        assert set(states(record).values()) <= {"hit", "done"}
        assert (folder.path / "number.txt").read_text() == str(reference(4))
        assert list((store / "work").iterdir()) == []
        assert bench_store.notes == []
    assert killed == 7


def test_code_edited_during_the_run_is_not_remembered(bench: Any, states: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.graph.run import execute

    monkeypatch.setattr(execute, "sources_changed", lambda definition: ["toy_pack.nodes"])
    record = bench.run(CUT)
    assert all("not remembered" in row["warnings"][0] for row in record["nodes"])
    monkeypatch.undo()
    assert set(states(bench.run(CUT)).values()) == {"done"}
