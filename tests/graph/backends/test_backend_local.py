"""Warm worker processes: parallel branches under tokens, deaths that cost one node, memory, interrupts, resuming."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.graph.run.backends.local import Local
from exmesh_graph.graph.run.runner import NodeFailed
from tests.graph.counting import count

TOY = Path(__file__).parent.parent / "toy"


def run(bench: Any, text: str, *sets: str, workers: int = 2, **options: Any) -> Any:
    return bench.run(text, *sets, backend=Local(workers), **options)


def folder(bench: Any) -> Path:
    return Path((bench.root / "runs" / "latest").resolve())


MEET = """
params: {{folder: ""}}
nodes:
  a: {{type: toy.const}}
  b: {{type: toy.{kind}, number: "@a.number", folder: "${{folder}}"}}
  c: {{type: toy.{kind}, number: "@a.number", seed: 7, folder: "${{folder}}"}}
  d: {{type: toy.add, a: "@b.number", b: "@c.number"}}
"""


@pytest.mark.thorough
def test_independent_branches_run_at_the_same_time(bench: Any, states: Any, tmp_path: Path) -> None:
    (tmp_path / "meet").mkdir()
    record = run(bench, MEET.format(kind="meet"), f"folder={tmp_path}/meet", tokens={"cpu": 2})
    assert set(states(record).values()) == {"done"}
    assert bench.value(record, "d") == 2


@pytest.mark.thorough
def test_a_node_goes_to_the_worker_that_holds_its_inputs(bench: Any, tmp_path: Path) -> None:
    (tmp_path / "meet").mkdir()
    text = (
        MEET.format(kind="meet").replace('${folder}"}', '${folder}", tell: true}')
        + """
  x: {type: toy.who, number: "@c.number"}
  y: {type: toy.who, number: "@b.number"}
"""
    )
    text = "".join(line for line in text.splitlines(keepends=True) if "toy.add" not in line)
    record = run(bench, text, f"folder={tmp_path}/meet", tokens={"cpu": 2})
    b, c, x, y = (bench.value(record, name) for name in "bcxy")
    assert b != c
    assert (x, y) == (c, b)


@pytest.mark.thorough
def test_a_named_token_keeps_nodes_apart(bench: Any, states: Any, tmp_path: Path) -> None:
    (tmp_path / "meet").mkdir()
    record = run(bench, MEET.format(kind="alone"), f"folder={tmp_path}/meet", tokens={"cpu": 2, "licence": 1})
    assert set(states(record).values()) == {"done"}


@pytest.mark.thorough
def test_a_token_that_the_machine_lacks_is_said(bench: Any) -> None:
    text = 'nodes: {a: {type: toy.const}, b: {type: toy.alone, number: "@a.number", folder: x}}'
    with pytest.raises(NodeFailed, match=r"toy\.alone asks for licence=1, and there is licence=0") as caught:
        run(bench, text)
    assert "--tokens licence=1" in str(caught.value)


@pytest.mark.thorough
def test_a_node_sees_the_gpus_it_was_given(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fake GPU tokens, numbered as the environment numbers them."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6")
    text = "nodes:\n" + "".join(
        f'  c{i}: {{type: toy.const, value: {i}}}\n  g{i}: {{type: toy.gpu, number: "@c{i}.number"}}\n' for i in (1, 2)
    )
    record = run(bench, text, tokens={"cpu": 2, "gpu": 2})
    assert {bench.value(record, f"g{i}") for i in (1, 2)} <= {4.0, 6.0}


@pytest.mark.thorough
def test_threads_are_granted_by_tokens(bench: Any) -> None:
    text = 'nodes: {a: {type: toy.const}, w: {type: toy.wide, number: "@a.number"}}'
    assert bench.value(run(bench, text, tokens={"cpu": 3}), "w") == 3.0


@pytest.mark.thorough
def test_one_process_serves_nodes_with_many_threads_and_with_one(bench: Any) -> None:
    """A new process imports torch and compiled kernels again, seconds each time."""
    text = """
nodes:
  a: {type: toy.narrow, number: "@c.number"}
  c: {type: toy.wide, number: "@d.number"}
  d: {type: toy.narrow, number: "@e.number"}
  e: {type: toy.wide, number: "@f.number"}
  f: {type: toy.const}
"""
    record = run(bench, text, tokens={"cpu": 2})
    assert bench.value(record, "e") == bench.value(record, "c") == 2.0
    assert bench.value(record, "a") == bench.value(record, "d")


@pytest.mark.thorough
def test_a_node_of_any_number_of_cores_makes_room_for_another(bench: Any, states: Any) -> None:
    (bench.root / "there").mkdir()
    text = MEET.format(kind="meet").replace("b: {type: toy.meet", "b: {type: toy.sharing")
    where = f"folder={bench.root / 'there'}"
    assert set(states(run(bench, text, where, tokens={"cpu": 2})).values()) == {"done"}
    assert set(states(run(bench, text, where, tokens={"cpu": 1})).values()) == {"hit"}  # cores are in no key


def test_a_chain_stays_in_one_process_and_in_its_memory(bench: Any) -> None:
    text = """
nodes:
  a: {type: toy.const, value: 5}
  s: {type: toy.series, number: "@a.number"}
  w: {type: toy.where, series: "@s.series"}
  v: {type: toy.who, number: "@w.number"}
"""
    backend = Local(2)
    before = bench.store.root
    taken = []
    forget = backend.forget

    def watch(digests: Any) -> None:
        gone = list(digests)
        taken.append(len(gone))
        forget(gone)

    backend.forget = watch  # type: ignore[method-assign]
    record = bench.run(text, backend=backend)
    assert bench.value(record, "w") == bench.value(record, "v") != os.getpid()
    assert sum(taken) == 4  # everything is let go in the end
    assert before.exists()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("segfault", "ended by SIGSEGV, a fault in a native library"),
        ("kill", "ended by SIGKILL, most often for want of memory"),
        ("abort", "ended by SIGABRT"),
        ("exit", "ended itself with exit status 7"),
    ],
)
@pytest.mark.reliability("a native library crashes, aborts, exits or is killed", "one failed node, with its last words")
def test_a_death_is_one_failed_node_with_its_last_words(bench: Any, states: Any, how: str, words: str) -> None:
    text = f"""
nodes:
  a: {{type: toy.const}}
  x: {{type: toy.crash, number: "@a.number", how: {how}}}
  b: {{type: toy.add, a: "@a.number"}}
  c: {{type: toy.add, a: "@x.number", b: "@b.number"}}
"""
    with pytest.raises(NodeFailed, match=words) as caught:
        run(bench, text, workers=1, keep_going=True)
    assert "| a native library says so" in str(caught.value)
    failed = json.loads((folder(bench) / "failures" / "x.json").read_text())
    assert "about to" in failed["traceback"]
    assert (folder(bench) / "logs" / "x.log").read_text().count("a native library says so") == 1
    record = json.loads((folder(bench) / "run.json").read_text())
    assert states(record) == {"a": "done", "x": "failed", "b": "done", "c": "blocked"}
    assert list(bench.store.verify()) == []
    again = bench.run(text, "x.how=nothing")
    assert states(again) == {"a": "hit", "x": "done", "b": "hit", "c": "done"}
    assert list((bench.store.root / "work").iterdir()) == []


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["interrupt", "signal"])
@pytest.mark.reliability(
    "a node raises KeyboardInterrupt; its worker gets a SIGINT", "one failed node; the run is not done"
)
def test_an_interrupt_that_nobody_asked_for_is_a_failed_node(bench: Any, states: Any, how: str) -> None:
    text = f"""
nodes:
  a: {{type: toy.const}}
  x: {{type: toy.crash, number: "@a.number", how: {how}}}
  c: {{type: toy.add, a: "@x.number"}}
"""
    with pytest.raises(NodeFailed, match="interrupted, though nobody stopped the run"):
        run(bench, text, workers=1, keep_going=True)
    record = json.loads((folder(bench) / "run.json").read_text())
    assert (record["state"], states(record)) == ("failed", {"a": "done", "x": "failed", "c": "blocked"})
    assert list(bench.store.verify()) == []
    assert states(bench.run(text, "x.how=nothing")) == {"a": "hit", "x": "done", "c": "done"}


def test_without_keep_going_the_rest_stops(bench: Any, states: Any) -> None:
    text = """
nodes:
  a: {type: toy.const}
  x: {type: toy.crash, number: "@a.number", how: leave}
  b: {type: toy.add, a: "@x.number"}
"""
    with pytest.raises(NodeFailed, match="SystemExit: 3"):
        run(bench, text)
    assert states(json.loads((folder(bench) / "run.json").read_text())) == {"a": "done", "x": "failed", "b": "waiting"}


def test_twins_in_one_run_are_computed_once(bench: Any, states: Any) -> None:
    text = """
nodes:
  a: {type: toy.const}
  b: {type: toy.slow, number: "@a.number", seconds: 0.3}
  c: {type: toy.slow, number: "@a.number", seconds: 0.3}
"""
    assert sorted(states(run(bench, text, tokens={"cpu": 2})).values()) == ["done", "done", "hit"]


@pytest.mark.thorough
@pytest.mark.reliability(
    "kill -9 of a node that keeps checkpoints; Ctrl-C",
    "it goes on from there and ends with the same bytes",
)
def test_a_killed_worker_goes_on_from_its_checkpoint(bench: Any, tmp_path: Path) -> None:
    """Killed at step 40 with a checkpoint at each: the next run does only the rest and ends with the same bytes."""
    whole = bench.run(count())
    other = type(bench)(tmp_path / "other", bench.packs)
    trace = tmp_path / "trace"
    more = f", trace: {trace}, stop_at: 40"
    with pytest.raises(NodeFailed, match="SIGKILL"):
        run(other, count(more), checkpoint_every=0.0)
    record = run(other, count(more), checkpoint_every=0.0)
    steps = [int(line) for line in trace.read_text().split()]
    assert len(steps) < 75
    assert steps[-1] == 59
    assert record["nodes"][1]["outputs"] == whole["nodes"][1]["outputs"]
    assert any("goes on from the checkpoint at step" in e.get("message", "") for e in other.events)
    assert list((other.store.root / "checkpoints").iterdir()) == []


@pytest.mark.thorough
def test_other_parameters_do_not_resume_a_checkpoint(bench: Any) -> None:
    with pytest.raises(NodeFailed):
        run(bench, count(", stop_at: 40"), checkpoint_every=0.0)
    bench.run(count(steps=61))
    assert not any("checkpoint" in e.get("message", "") for e in bench.events)


def test_checkpoints_must_be_declared(bench: Any) -> None:
    with pytest.raises(NodeFailed, match="resumable=True"):
        bench.run('nodes: {a: {type: toy.const}, u: {type: toy.undeclared, number: "@a.number"}}')


START = [sys.executable, "-c", "from exmesh_graph.cli import main; main()", "run", "g.yaml"]


def command(bench: Any, text: str, *words: str, pack: Path = TOY) -> subprocess.Popen[str]:
    bench.write(text, "g.yaml")
    path = os.pathsep.join([str(pack), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "EXMESH_STORE": str(bench.store.root)}
    return subprocess.Popen(
        [*START, *words], cwd=bench.root, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def wait_for(condition: Any, seconds: float = 20) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("workers", ["0", "1"])
@pytest.mark.reliability(
    "kill -9 of a node that keeps checkpoints; Ctrl-C",
    "it goes on from there and ends with the same bytes",
)
def test_ctrl_c_writes_a_checkpoint_and_the_same_command_goes_on(bench: Any, tmp_path: Path, workers: str) -> None:
    whole = bench.run(count(steps=600))
    bench = type(bench)(tmp_path / "other", bench.packs)
    trace = tmp_path / "trace"
    text = count(f", seconds: 0.01, trace: {trace}", steps=600)
    process = command(bench, text, "--workers", workers)
    wait_for(lambda: trace.exists() and len(trace.read_text().split()) > 20)
    process.send_signal(signal.SIGINT)
    shown = process.communicate(timeout=30)
    assert process.returncode == 130, shown
    done = len(trace.read_text().split())
    assert 20 < done < 600
    assert "go on with the same command" in shown[1]
    assert json.loads((folder(bench) / "run.json").read_text())["nodes"][1]["state"] == "interrupted"
    assert list((bench.store.root / "work").iterdir()) == []
    record = bench.run(text, "n.seconds=0")
    assert record["nodes"][1]["outputs"] == whole["nodes"][1]["outputs"]
    assert [int(line) for line in trace.read_text().split()] == list(range(600))  # no step was done twice


def workers_of(pid: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


@pytest.mark.thorough
def test_workers_of_a_killed_run_end_and_another_run_goes_on(bench: Any, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    text = count(f", seconds: 0.02, trace: {trace}", steps=600)
    process = command(bench, text)
    wait_for(lambda: trace.exists() and len(trace.read_text().split()) > 5)
    found = workers_of(process.pid)
    assert found
    process.kill()
    process.communicate()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in found))
    record = bench.run(text, "n.seconds=0")  # the dead run's lease does not hold it up
    assert record["state"] == "done"
    assert list((bench.store.root / "work").iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("twice", [False, True])
def test_a_hanging_node_is_killed_after_a_while_or_a_second_ctrl_c(bench: Any, tmp_path: Path, twice: bool) -> None:
    mark = tmp_path / "mark"
    text = f'nodes: {{a: {{type: toy.const}}, h: {{type: toy.hang, number: "@a.number", path: {mark}}}}}'
    process = command(bench, text, "--workers", "1")
    wait_for(mark.exists)
    found = workers_of(process.pid)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    if twice:
        events = bench.root / "runs" / "latest" / "events.jsonl"
        wait_for(lambda: '"stopping"' in events.read_text())
        process.send_signal(signal.SIGINT)
    shown = process.communicate(timeout=30)
    assert process.returncode == 130, shown
    assert "exmesh run g.yaml --workers 1" in shown[1]
    if not twice:
        assert time.monotonic() - began >= 3
    assert not any(Path(f"/proc/{pid}").exists() for pid in found)
    assert list((bench.store.root / "work").iterdir()) == []


@pytest.mark.slow
def test_two_runs_at_once_compute_a_key_once(bench: Any) -> None:
    """The second runner meets the first one's lease, waits, and takes the hit."""
    text = 'nodes: {a: {type: toy.const}, s: {type: toy.slow, number: "@a.number", seconds: 2, steps: 20}}'
    first = command(bench, text)
    events = bench.root / "runs" / "latest" / "events.jsonl"
    wait_for(lambda: events.exists() and '"node_started", "node": "s"' in events.read_text())
    record = bench.run(text)
    assert {row["name"]: row["state"] for row in record["nodes"]} == {"a": "hit", "s": "hit"}
    assert any("waits for process" in e.get("message", "") for e in bench.events)
    first.communicate(timeout=30)
    assert first.returncode == 0


@pytest.mark.slow
def test_code_edited_while_a_run_goes_on_is_not_remembered(bench: Any, tmp_path: Path) -> None:
    """The helper changes after its module was imported by run and worker, and before its node is planned."""
    pack = tmp_path / "pack"
    shutil.copytree(TOY, pack)
    text = """
nodes:
  a: {type: toy.const, value: 5}
  w: {type: toy.slow, number: "@a.number", seconds: 2, steps: 20}
  s: {type: toy.sign, number: "@w.number"}
"""
    for workers in ("0", "1"):
        process = command(bench, text, "--workers", workers, "--store", workers, pack=pack)
        events = bench.root / "runs" / "latest" / "events.jsonl"
        wait_for(lambda events=events: events.exists() and '"node": "w", "step"' in events.read_text())
        helper = pack / "toy_pack" / "helpers.py"
        old = helper.read_text()
        helper.write_text(old.replace("1.0 if value", "2.0 if value"))
        shown = process.communicate(timeout=30)
        assert process.returncode == 0, shown
        assert "not remembered: its code changed during the run" in shown[0]
        again = command(bench, text, "--store", workers, pack=pack).communicate(timeout=30)[0]
        assert "done s" in again
        helper.write_text(old)
        (bench.root / "runs" / "latest").unlink()


@pytest.mark.thorough
def test_another_result_of_a_random_node_replaces_the_first(bench: Any, states: Any) -> None:
    text = """
nodes:
  a: {type: toy.const}
  d: {type: toy.dice, number: "@a.number"}
  b: {type: toy.add, a: "@d.number"}
"""
    first = run(bench, text)
    second = run(bench, text, force={"d"})
    assert states(second) == {"a": "hit", "d": "done", "b": "done"}
    assert bench.value(second, "b") == bench.value(second, "d") != bench.value(first, "d")
    third = run(bench, text)
    assert set(states(third).values()) == {"hit"}
    assert bench.value(third, "d") == bench.value(second, "d")
