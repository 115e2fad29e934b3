"""One suite over every backend: equal results and digests, one failed node, cancelling, tokens, logs, checkpoints."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.run.backends import Inline
from exmesh_graph.graph.run.job import DONE, FAILED, STOPPED, Job, Outcome
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import NodeFailed, Runner
from exmesh_graph.graph.run.schedule import Pool
from tests.graph.counting import count

GRAPH = """
name: conformance
seed: 3
params: {n: 3}
nodes:
  one: {type: toy.const, value: 1}
  rounds:
    repeat: "${n}"
    carry: {state: "@one.number"}
    nodes:
      step: {type: toy.step, state: "@carry.state", amount: "${round}"}
    next: {state: "@step.state"}
  files: {type: toy.folder, number: "@rounds.state"}
  back: {type: toy.read_folder, files: "@files.files"}
  series: {type: toy.series, number: "@back.number"}
  seeded: {type: toy.seeded, number: "@one.number"}
  total: {type: toy.add, a: "@back.number", b: "@seeded.number"}
outputs: {figure: "@total.number"}
"""


def folder(bench: Any) -> Path:
    return Path((bench.root / "runs" / "latest").resolve())


@pytest.mark.thorough
def test_results_and_digests_are_those_of_any_other_backend(
    bench: Any, states: Any, run_on: Any, tmp_path: Path
) -> None:
    other = type(bench)(tmp_path / "other", bench.packs)
    there = other.run(GRAPH, backend=Inline(other.store))
    here = run_on(GRAPH)
    for a, b in zip(there["nodes"], here["nodes"], strict=True):
        assert (a["name"], a["key"], a["outputs"]) == (b["name"], b["key"], b["outputs"])
    assert bench.value(here, "total") == 11.0
    assert (folder(bench) / "figure" / "number.json").is_file()
    assert set(states(run_on(GRAPH)).values()) == {"hit"}
    assert list(bench.store.verify()) == []
    assert list((bench.store.root / "work").iterdir()) == []


FAIL = """
nodes:
  a: {type: toy.const, value: 5}
  x: {type: toy.fail, number: "@a.number", value: 9}
  b: {type: toy.add, a: "@a.number"}
  c: {type: toy.add, a: "@x.number", b: "@b.number"}
"""


@pytest.mark.thorough
def test_a_failure_is_one_node(bench: Any, states: Any, run_on: Any) -> None:
    with pytest.raises(NodeFailed, match="x: toy: the number is too small") as caught:
        run_on(FAIL, keep_going=True)
    assert "expected: above 9" in str(caught.value)
    assert "DataError" in caught.value.record["traceback"]
    record = json.loads((folder(bench) / "run.json").read_text())
    assert states(record) == {"a": "done", "x": "failed", "b": "done", "c": "blocked"}
    assert any(e["event"] == "warning" and e["message"] == "about to compare" for e in bench.events)
    assert states(run_on(FAIL, "x.value=1")) == {"a": "hit", "x": "done", "b": "hit", "c": "done"}


@pytest.mark.thorough
@pytest.mark.parametrize(("how", "words"), [("segfault", "SIGSEGV"), ("kill", "SIGKILL"), ("exit", "exit status 7")])
def test_a_dead_process_is_one_node(bench: Any, states: Any, run_on: Any, kind: str, how: str, words: str) -> None:
    if kind == "inline":
        pytest.skip("inline jobs share the process of the run")
    text = FAIL.replace("toy.fail", "toy.crash").replace("value: 9", f"how: {how}")
    with pytest.raises(NodeFailed, match=words):
        run_on(text, keep_going=True)
    record = json.loads((folder(bench) / "run.json").read_text())
    assert states(record) == {"a": "done", "x": "failed", "b": "done", "c": "blocked"}
    assert "a native library says so" in (folder(bench) / "logs" / "x.log").read_text()
    assert list(bench.store.verify()) == []


@pytest.mark.thorough
def test_a_broken_input_is_made_again(bench: Any, states: Any, run_on: Any) -> None:
    first = run_on(GRAPH)
    digest = next(row for row in first["nodes"] if row["name"] == "files")["outputs"]["files"]["digest"]
    path = bench.store.data(digest) / "files" / "number.txt"
    path.chmod(0o644)
    path.write_text("9" * len(path.read_text()))
    record = run_on(GRAPH, force={"back"})
    assert bench.value(record, "total") == 11.0
    assert states(record)["files"] == "done"


NAMED = """
params: {folder: ""}
nodes:
  a: {type: toy.const}
  b: {type: toy.KIND, number: "@a.number", folder: "${folder}", seed: 1}
  c: {type: toy.KIND, number: "@a.number", folder: "${folder}", seed: 2}
"""


LISTS = """
nodes:
  a: {type: toy.const, value: 4}
  cut: {type: toy.cut, number: "@a.number"}
  each: {type: toy.step, each: state, state: "@cut.parts", amount: 1}
  all: {type: toy.gather, numbers: "@each.state"}
  m: {type: toy.maybe, number: "@all.number"}
  off: {type: toy.sign, number: "@m.below"}
  on: {type: toy.sign, number: "@m.above"}
"""


@pytest.mark.thorough
def test_lists_are_mapped_and_gathered_and_what_is_absent_switches_off(bench: Any, states: Any, run_on: Any) -> None:
    record = run_on(LISTS)
    assert bench.value(record, "all") == 23449  # 2, 3, 4, 5 in order, and -1 for `more`
    assert {name for name, state in states(record).items() if state == "idle"} == {"off"}
    assert {f"each[{n}]" for n in (1, 2, 3, 4)} <= states(record).keys()
    longer = states(run_on(LISTS.replace("value: 4", "value: 5")))
    assert {name for name, state in longer.items() if state == "hit"} == {f"each[{n}]" for n in (1, 2, 3, 4)}


@pytest.mark.thorough
def test_a_limit_is_one_failed_node_and_a_passing_cause_is_tried_again(
    bench: Any, states: Any, run_on: Any, kind: str, tmp_path: Path
) -> None:
    (tmp_path / "tries").mkdir()
    flaky = 'nodes: {a: {type: toy.const}, f: {type: toy.flaky, number: "@a.number", folder: %s, until: 2, limits: %s}}'
    assert states(run_on(flaky % (tmp_path / "tries", "{retries: 1}")))["f"] == "done"
    if kind != "inline":
        slow = "{type: toy.greedy, number: '@a.number', seconds: 60, limits: {seconds: 1}}"
        with pytest.raises(NodeFailed, match="past its limit of 1"):
            run_on(f"nodes: {{a: {{type: toy.const}}, g: {slow}}}")


@pytest.mark.thorough
def test_named_tokens_keep_nodes_apart(states: Any, run_on: Any, tmp_path: Path) -> None:
    (tmp_path / "meet").mkdir()
    record = run_on(NAMED.replace("KIND", "alone"), f"folder={tmp_path}/meet", tokens={"licence": 1})
    assert set(states(record).values()) == {"done"}


@pytest.mark.thorough
def test_independent_nodes_run_at_the_same_time(states: Any, run_on: Any, kind: str, tmp_path: Path) -> None:
    if kind == "inline":
        pytest.skip("inline jobs run one after the other")
    (tmp_path / "meet").mkdir()
    record = run_on(NAMED.replace("KIND", "meet"), f"folder={tmp_path}/meet")
    assert set(states(record).values()) == {"done"}


def test_a_token_that_is_not_there_is_said(run_on: Any) -> None:
    with pytest.raises(NodeFailed, match=r"toy\.alone asks for licence=1, and there is licence=0"):
        run_on(NAMED.replace("KIND", "alone"), "folder=x")


def test_threads_are_those_of_one_machine(bench: Any, run_on: Any, kind: str, monkeypatch: Any) -> None:
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    if kind == "inline":
        pytest.skip("the thread pools of this process are set already")
    text = 'nodes: {a: {type: toy.const}, w: {type: toy.wide, number: "@a.number"}}'
    assert bench.value(run_on(text), "w") == 2.0


@pytest.mark.thorough
def test_progress_logs_and_prints_arrive(bench: Any, run_on: Any, kind: str) -> None:
    text = 'nodes: {a: {type: toy.const}, s: {type: toy.slow, number: "@a.number", seconds: 0.6, steps: 6}}'
    run_on(text + "\n")
    steps = [e["step"] for e in bench.events if e["event"] == "progress" and e["node"] == "s"]
    assert steps == sorted(steps)
    assert steps[-1] == 6
    assert len(steps) > 1
    if kind != "inline":
        run_on('nodes: {a: {type: toy.const}, x: {type: toy.crash, number: "@a.number", how: nothing}}')
        assert (folder(bench) / "logs" / "x.log").read_text().splitlines()[-1] in (
            "about to nothing",
            "a native library says so",
        )


@pytest.mark.thorough
def test_a_killed_node_goes_on_from_its_checkpoint(bench: Any, run_on: Any, kind: str, tmp_path: Path) -> None:
    if kind == "inline":
        pytest.skip("inline jobs share the process of the run")
    other = type(bench)(tmp_path / "other", bench.packs)
    whole = other.run(count())
    trace = tmp_path / "trace"
    text = count(f", trace: {trace}, stop_at: 40")
    with pytest.raises(NodeFailed, match="SIGKILL"):
        run_on(text, checkpoint_every=0.0)
    record = run_on(text, checkpoint_every=0.0)
    assert record["nodes"][1]["outputs"] == whole["nodes"][1]["outputs"]
    steps = [int(line) for line in trace.read_text().split()]
    assert steps == list(range(60))
    assert any("goes on from the checkpoint at step 40" in e.get("message", "") for e in bench.events)


class Taken(Exception):
    """Thrown instead of running a job."""


def job_of_count(bench: Any, name: str, trace: Path, monkeypatch: pytest.MonkeyPatch, seconds: float) -> Job:
    """The job that a run would make of a node that counts, to 400 when it takes its time and else to 3."""
    text = count(f", seconds: {seconds}, trace: {trace}", name, 400 if seconds else 3)
    jobs = []

    def submit(self: Inline, job: Job) -> None:
        if job.name == name:
            jobs.append(job)
            raise Taken
        self.waiting.append(job)

    graph = bench.check(text)
    run = Runner(graph, bench.store, RunFolder(bench.root / "runs", name), lambda event: None, checkpoint_every=0.0)
    monkeypatch.setattr(Inline, "submit", submit)
    with pytest.raises(Taken):
        run.run()
    monkeypatch.undo()
    return jobs[0]


def outcomes(backend: Any, seconds: float) -> list[Outcome]:
    found: list[Outcome] = []
    end = time.monotonic() + seconds
    while not found and time.monotonic() < end:
        found = backend.poll(0.2, lambda event: None)
    return found


def wait_for(path: Path, backend: Any) -> None:
    end = time.monotonic() + 30
    while not path.exists():
        assert backend.poll(0.1, lambda event: None) == []
        assert time.monotonic() < end


@pytest.mark.thorough
def test_cancel_ends_a_job_at_once_without_an_outcome(
    bench: Any, backend: Any, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "inline":
        pytest.skip("inline jobs run within poll")
    slow = job_of_count(bench, "n", tmp_path / "slow", monkeypatch, 0.1)
    quick = job_of_count(bench, "m", tmp_path / "quick", monkeypatch, 0.0)
    engine = backend(bench.store)
    engine.submit(slow)
    wait_for(tmp_path / "slow", engine)
    engine.cancel("n")
    assert engine.poll(0.5, lambda event: None) == []
    count = len((tmp_path / "slow").read_text().split())
    engine.submit(quick)
    (outcome,) = outcomes(engine, 40)
    assert (outcome.name, outcome.state) == ("m", DONE)
    assert len((tmp_path / "slow").read_text().split()) <= count + 3


@pytest.mark.thorough
def test_stop_lets_a_job_write_its_checkpoint(
    bench: Any, backend: Any, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "inline":
        pytest.skip("nothing runs between two polls of inline jobs")
    trace = tmp_path / "trace"
    job = job_of_count(bench, "n", trace, monkeypatch, 0.05)
    engine = backend(bench.store)
    engine.submit(job)
    wait_for(trace, engine)
    engine.stop()
    (outcome,) = outcomes(engine, 20)
    assert (outcome.name, outcome.state) == ("n", STOPPED)
    done = len(trace.read_text().split())
    assert 0 < done < 400
    engine.submit(job)
    wait_for_more = time.monotonic() + 20
    while len(trace.read_text().split()) <= done and time.monotonic() < wait_for_more:
        engine.poll(0.1, lambda event: None)
    assert int(trace.read_text().split()[done]) == done
    engine.cancel("n")


def test_an_unknown_node_type_is_a_failed_job(
    bench: Any, backend: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    import dataclasses

    job = job_of_count(bench, "n", tmp_path / "trace", monkeypatch, 0.0)
    engine = backend(bench.store)
    engine.submit(dataclasses.replace(job, params={"steps": "many"}))
    (outcome,) = outcomes(engine, 40)
    assert outcome.state == FAILED
    assert "steps" in outcome.info["message"]


def test_without_ray_its_backend_says_what_to_install(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from exmesh_graph.errors import MissingLibraryError
    from exmesh_graph.graph.run.backends.ray import RayCluster

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingLibraryError, match="exmesh-graph\\[ray\\]"):
        RayCluster(bench.store)


def test_ray_is_imported_only_where_it_is_used() -> None:
    code = "import sys, exmesh_graph.graph.run.backends.ray, exmesh_graph.cli.app; assert 'ray' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_job_may_have_at_most_what_one_machine_has(bench: Any) -> None:
    pool = Pool({"cpu": 12, "jobs": 12, "ram_gb": 90}, {"cpu": 4, "ram_gb": 30})
    nodes = bench.check('nodes: {a: {type: toy.const}, w: {type: toy.wide, number: "@a.number"}}').nodes
    assert pool.wanted(nodes["w"])["cpu"] == 4
    pool.take("first", pool.wanted(nodes["w"]))
    assert pool.fits(pool.wanted(nodes["w"]))
    few = Pool({"cpu": 2, "jobs": 2}, {"cpu": 4})
    assert few.wanted(nodes["w"])["cpu"] == 2
