"""Jobs: plain JSON that another process can run, and what the in-memory cache keeps."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.backends import Inline
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import BROKEN, FAILED, Job, Outcome
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.graph.run.runner import NodeFailed

GRAPH = """
nodes:
  a: {type: toy.const, value: 5}
  t: {type: toy.split, number: "@a.number"}
  s: {type: toy.series, number: "@t.train"}
  x: {type: toy.train_only, number: "@t.train"}
  b: {type: toy.add, a: "@x.number"}
  f: {type: toy.folder, number: "@b.number"}
  r: {type: toy.read_folder, files: "@f.files"}
  q: {type: toy.file, path: data/x.txt}
outputs: {asset: "@f.files"}
"""


class ThroughJson(Inline):
    """Every job and outcome passes through JSON text and runs with an empty memory, as in another process."""

    def submit(self, job: Job) -> None:
        super().submit(Job.from_json(json.loads(json.dumps(job.to_json()))))

    def poll(self, timeout: float, emit: Any) -> list[Outcome]:
        self.memory = Memory()
        return [Outcome.from_json(json.loads(json.dumps(o.to_json()))) for o in super().poll(timeout, emit)]


def test_a_job_is_all_that_another_process_needs(bench: Any, states: Any) -> None:
    bench.write("1.5", "data/x.txt")
    record = bench.run(GRAPH, backend=ThroughJson(bench.store))
    assert set(states(record).values()) == {"done"}
    assert bench.value(record, "r") == 5.0
    assert set(states(bench.run(GRAPH)).values()) == {"hit"}  # keys and records are the same either way


def test_a_failure_keeps_its_words_through_json(bench: Any) -> None:
    text = 'nodes: {a: {type: toy.const}, x: {type: toy.fail, number: "@a.number", value: 9}}'
    with pytest.raises(NodeFailed, match="x: toy: the number is too small") as caught:
        bench.run(text, backend=ThroughJson(bench.store))
    assert caught.value.cause is None
    assert caught.value.record["error"] == "DataError"
    assert 'raise DataError("the number is too small"' in caught.value.record["traceback"]
    job = Job.from_json(caught.value.record["job"])
    again = execute(job, bench.store, Memory(), bench.events.append)
    assert (again.state, again.info["what"]) == (FAILED, "the number is too small")


def job_of_failure(bench: Any) -> Job:
    text = 'nodes: {a: {type: toy.const}, x: {type: toy.fail, number: "@a.number", value: 9}}'
    with pytest.raises(NodeFailed) as caught:
        bench.run(text)
    return Job.from_json(caught.value.record["job"])


def test_an_input_that_is_gone_is_said_by_port(bench: Any, tmp_path: Path) -> None:
    outcome = execute(job_of_failure(bench), Store(tmp_path / "elsewhere"), Memory(), bench.events.append)
    assert (outcome.state, outcome.info["port"]) == (BROKEN, "number")


def test_a_type_that_no_pack_defines(bench: Any) -> None:
    job = Job.from_json({**job_of_failure(bench).to_json(), "type": "toy.gone"})
    outcome = execute(job, bench.store, Memory(), bench.events.append)
    assert isinstance(outcome.cause, GraphError)
    assert "there is no node type 'toy.gone'" in outcome.info["message"]


class Gone(Inline):
    """Forgets all values between jobs, so that each is read from the store."""

    def poll(self, timeout: float, emit: Any) -> list[Outcome]:
        self.memory = Memory()
        return super().poll(timeout, emit)


def test_what_breaks_while_a_run_goes_on_is_made_again(bench: Any, states: Any) -> None:
    """A value that others still need is damaged on the disk after it was made."""
    text = """
nodes:
  a: {type: toy.const, value: 5}
  b: {type: toy.step, state: "@a.number"}
  c: {type: toy.step, state: "@b.state"}
  d: {type: toy.subtract, a: "@b.state", b: "@c.state"}
"""
    hurt = []

    class Damage(Gone):
        def poll(self, timeout: float, emit: Any) -> list[Outcome]:
            done = super().poll(timeout, emit)
            if done[0].name == "c" and not hurt:
                hurt.append(self.store.data(rows(bench.run_, "b")["state"]["digest"]) / "number.json")
                hurt[0].chmod(0o644)
                hurt[0].write_text("x")
            return done

    def rows(run: Any, name: str) -> Any:
        return run.rows[name]["outputs"]

    from exmesh_graph.graph.run.rundir import RunFolder
    from exmesh_graph.graph.run.runner import Runner

    folder = RunFolder(bench.root / "runs", "damage")
    bench.run_ = Runner(bench.check(text), bench.store, folder, bench.events.append, backend=Damage(bench.store))
    record = bench.run_.run()
    folder.close()
    assert hurt
    assert set(states(record).values()) == {"done"}
    assert bench.value(record, "d") == -1
    assert [e["node"] for e in bench.events if "made again" in e.get("message", "")] == ["b"]
    assert [e["node"] for e in bench.events if e["event"] == "node_finished"] == ["a", "b", "c", "b", "d"]
    assert list(bench.store.verify()) == []


def test_memory_drops_the_least_recently_used_beyond_its_budget(packs: Any) -> None:
    from toy_pack.nodes import Series

    memory = Memory(budget=10_000)

    def held() -> Iterable[str]:
        return list(memory.values)

    for name in "abc":
        memory.put(name, Series(np.zeros(1000, np.float32)))
    assert held() == ["b", "c"]
    assert memory.get("b") is not None
    memory.put("d", Series(np.zeros(1000, np.float32)))
    assert held() == ["b", "d"]
    assert memory.bytes == 8000
    memory.put("huge", Series(np.zeros(10_000, np.float32)))
    assert held() == []
    assert memory.bytes == 0
    series = Series(np.zeros(10, np.float32))
    memory.put("e", series)
    assert not series.data.flags.writeable
