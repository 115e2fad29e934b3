"""Limits of a node: time, memory, disk, and how often it is tried again for causes that pass."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.errors import LimitError, PassingError, may_pass
from exmesh_graph.graph.run.backends import local
from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.runner import NodeFailed

GREEDY = """
nodes:
  a: {type: toy.const}
  g: {type: toy.greedy, number: "@a.number", %s}
"""
FLAKY = """
nodes:
  a: {type: toy.const}
  f: {type: toy.flaky, number: "@a.number", folder: %s, until: %d, how: %s, limits: {retries: %d}}
"""


def past_its_limit(bench: Any, words: str) -> str:
    """The message of the one failure; nothing of the attempt is left."""
    began = time.monotonic()
    with pytest.raises(NodeFailed) as caught:
        bench.run(GREEDY % words, backend=Local(1))
    assert time.monotonic() - began < 20
    assert [record["node"] for record in caught.value.records] == ["g"]
    assert caught.value.record["error"] == "LimitError"
    assert caught.value.record["replay"] == "exmesh run --node g"
    assert "graph.yaml:4" in caught.value.record["message"]
    assert list(bench.store.work.iterdir()) == []
    return str(caught.value.record["message"])


@pytest.mark.thorough
@pytest.mark.reliability("a node takes more time, memory or disk than its limits say", "it is stopped: one failed node")
@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("seconds: 60, limits: {seconds: 1}", "seconds, past its limit of 1"),
        ("seconds: 60, megabytes: 500, limits: {ram_gb: 0.3}", "ram_gb, past its limit of 0.3"),
        ("seconds: 60, megabytes: 500, by_child: true, limits: {ram_gb: 0.3}", "ram_gb, past its limit of 0.3"),
        ("seconds: 60, disk: 40, limits: {disk_gb: 0.02}", "disk_gb, past its limit of 0.02"),
    ],
)
def test_a_node_past_its_limit_is_one_failed_node(bench: Any, words: str, told: str) -> None:
    assert told in past_its_limit(bench, words)


@pytest.mark.thorough
def test_memory_is_measured_where_no_control_group_can_be_made(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exmesh_graph.graph.run.backends.local.confine", lambda *_: None)
    words = "seconds: 60, megabytes: 500, by_child: true, limits: {ram_gb: 0.3}"
    assert "past its limit of 0.3" in past_its_limit(bench, words)  # the child's: the node itself takes less


@pytest.mark.thorough
def test_a_node_within_its_limits_runs_and_the_next_one_is_not_bound_by_them(
    bench: Any, states: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A limit of memory is that of a process of its own: what other nodes left in a warm one does not count."""
    begun: list[str] = []
    real = local._Worker.__init__

    def counted(worker: Any, job: Any, budget: int) -> None:
        begun.append(job.name)
        real(worker, job, budget)

    monkeypatch.setattr(local._Worker, "__init__", counted)
    text = GREEDY % "megabytes: 100, limits: {ram_gb: 0.7, seconds: 60, disk_gb: 1, retries: 1}"
    text += '  h: {type: toy.greedy, number: "@g.number", megabytes: 900}\n'
    record = bench.run(text, backend=Local(1))
    assert set(states(record).values()) == {"done"}
    assert begun == ["a", "g", "h"]
    assert record["resolved"]["nodes"]["g"]["limits"] == {"ram_gb": 0.7, "seconds": 60, "disk_gb": 1, "retries": 1}
    tight = text.replace("ram_gb: 0.7", "ram_gb: 4")
    assert set(states(bench.run(tight, backend=Local(1))).values()) == {"hit"}  # limits are in no key


def test_limits_of_the_graph_are_those_of_each_node_that_has_none(bench: Any) -> None:
    text = "limits: {seconds: 5, retries: 3}\n" + GREEDY % "limits: {seconds: 9}"
    nodes = bench.check(text).with_idle().nodes
    assert nodes["a"].limits == {"seconds": 5, "retries": 3}
    assert nodes["g"].limits == {"seconds": 9, "retries": 3}
    assert bench.check(text, "g.limits={seconds: 7}").with_idle().nodes["g"].limits["seconds"] == 7


@pytest.mark.parametrize("limits", ["{seconds: 0}", "{secs: 5}", "{ram_gb: true}", "{retries: 1.5}", "{retries: -1}",
                                    "5", "{disk_gb: .inf}"])  # fmt: skip
def test_what_is_no_limit_is_told_where_it_stands(bench: Any, limits: str) -> None:
    (problem,) = bench.problems(GREEDY % f"limits: {limits}")
    assert problem.code == "limits"
    assert problem.where.line == 4
    assert "retries: 2" in problem.expected


def test_in_the_runs_own_process_limits_are_told_not_to_be_kept(bench: Any) -> None:
    bench.run(GREEDY % "limits: {seconds: 60}")
    told = [event["message"] for event in bench.events if event["event"] == "warning"]
    assert told == ["its limits are not kept: it runs in the process of the run, which would end with it"]


@pytest.mark.thorough
@pytest.mark.reliability("a cause that passes: a lost network, a busy device, the out-of-memory killer",
                         "tried again as often as its limits say, then one failed node")  # fmt: skip
@pytest.mark.parametrize("how", ["network", "own", "kill"])
def test_a_cause_that_passes_is_waited_for(bench: Any, states: Any, tmp_path: Path, how: str) -> None:
    (tmp_path / "tries").mkdir()
    record = bench.run(FLAKY % (tmp_path / "tries", 2, how, 1), backend=Local(1))
    assert states(record) == {"a": "done", "f": "done"}
    first, second = sorted(int(path.name) for path in (tmp_path / "tries").iterdir())
    assert second - first > 0.9e9  # nanoseconds
    (told,) = [event["message"] for event in bench.events if event["event"] == "warning"]
    assert told.startswith("tried again in 1 s (1 of 1): ")


@pytest.mark.parametrize(("how", "until", "retries", "attempts"), [("fault", 5, 3, 1), ("own", 5, 1, 2)])
def test_others_are_not_nor_more_often_than_allowed(
    bench: Any, tmp_path: Path, how: str, until: int, retries: int, attempts: int
) -> None:
    (tmp_path / "tries").mkdir()
    with pytest.raises(NodeFailed):
        bench.run(FLAKY % (tmp_path / "tries", until, how, retries))
    assert len(list((tmp_path / "tries").iterdir())) == attempts
    assert json.loads((bench.root / "runs/latest/failure.json").read_text())["node"] == "f"


def test_what_may_pass() -> None:
    caused = RuntimeError("no")
    caused.__cause__ = OSError(28, "No space left on device")
    assert may_pass(caused)
    assert may_pass(PassingError("busy"))
    assert not may_pass(LimitError("too much"))
    assert not may_pass(FileNotFoundError(2, "gone"))
    assert not may_pass(ValueError("no"))
