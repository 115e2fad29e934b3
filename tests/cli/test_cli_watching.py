"""status, log, replay, and the views of a run."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exmesh_graph.api.board import Board, RunningNode

TOY = Path(__file__).parent.parent / "graph" / "toy"
START = [sys.executable, "-c", "from exmesh_graph.cli import main; main()"]
Exmesh = Callable[..., Any]  # of conftest.py

GRAPH = """
name: watched
nodes:
  a: {type: toy.const, value: 3}
  x: {type: toy.crash, number: "@a.number", how: nothing}
  s: {type: toy.slow, number: "@x.number", seconds: 0.2, steps: 4}
  t: {type: toy.slow, number: "@a.number", seconds: 0.2, steps: 5}
  bad: {type: toy.fail, number: "@s.number", value: 1}
  end: {type: toy.step, state: "@bad.number"}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "g.yaml").write_text(GRAPH)
    return tmp_path


def environment() -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(TOY), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "100"}


def wait_for(condition: Callable[[], bool], seconds: float = 20) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.thorough
def test_log_of_a_run_and_of_a_node(exmesh: Exmesh, folder: Path) -> None:
    exmesh("run", "g.yaml")
    whole = exmesh("log").stdout
    for words in ("6 nodes", "x  starts", "x  done", "bad  warning: about to compare", "done after"):
        assert words in whole
    assert "a native library says so" not in whole
    one = exmesh("log", "runs/latest", "x").stdout
    assert "| about to nothing" in one
    assert "| a native library says so" in one
    assert "starts" in one
    assert "4/4  loss 0.25" in exmesh("log", "runs/latest", "s").stdout
    assert "expected: s" in exmesh("log", "runs/latest", "ss", code=1).stderr
    assert "no run folder" in exmesh("log", "elsewhere", code=1).stderr


@pytest.mark.thorough
def test_a_failure_is_replayed_alone_on_its_inputs(exmesh: Exmesh, folder: Path) -> None:
    failed = exmesh("run", "g.yaml", "--set", "bad.value=9", code=1)
    file = next((folder / "runs" / "latest").resolve().glob("failures/*.json"))
    assert file.name == "bad.json"
    assert f"exmesh replay runs/{file.parent.parent.name}/failures/bad.json" in failed.stderr
    (folder / "g.yaml").write_text("nodes: {other: {type: toy.const}}")  # the graph has moved on
    words = [*START, "replay", str(file)]
    again = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    assert again.returncode == 1
    assert 'raise DataError("the number is too small"' in again.stderr
    assert "failed again: bad: toy: the number is too small" in again.stderr
    record = json.loads(file.read_text())
    record["job"]["params"]["value"] = 1.0  # as if its code had been mended
    file.write_text(json.dumps(record))
    assert "bad is done in" in exmesh("replay", str(file)).stdout
    (folder / "g.yaml").write_text(GRAPH)
    assert "hit  bad" in exmesh("run", "g.yaml").stdout


@pytest.mark.thorough
def test_replay_says_what_is_missing(exmesh: Exmesh, folder: Path) -> None:
    exmesh("run", "g.yaml", "--set", "bad.value=9", code=1)
    file = "runs/latest/failures/bad.json"
    assert "no failure file" in exmesh("replay", "g.yaml", code=1).stderr
    assert "is no longer in the store" in exmesh("replay", file, "--store", "empty", code=1).stderr


@pytest.mark.thorough
def test_keep_going_runs_what_does_not_need_the_failed_node(exmesh: Exmesh, folder: Path) -> None:
    failed = exmesh("run", "g.yaml", "--set", "x.how=exit", "--keep-going", "--workers", "1", code=1)
    assert "ended itself with exit status 7" in failed.stderr
    assert "done t" in failed.stdout
    assert "failed x  " in failed.stdout
    assert "blocked s\n" in failed.stdout
    shown = exmesh("status").stdout.splitlines()
    assert (shown[0].split()[0], shown[1].split()) == ("failed", ["at", "x"])
    assert "s  blocked: needs what failed" in exmesh("log").stdout


@pytest.mark.thorough
def test_the_command_to_go_on_asks_for_the_same_nodes(exmesh: Exmesh, folder: Path) -> None:
    failed = exmesh("run", "g.yaml", "--set", "x.how=exit", "--node", "s", "--node", "t", "--workers", "1", code=1)
    lines = [line.strip() for line in failed.stderr.splitlines()]
    command = "exmesh run g.yaml --set x.how=exit --workers 1"
    assert f"go on when mended: {command} --node s --node t" in lines
    assert f"this node as the graph is now: {command} --node x" in lines


@pytest.mark.thorough
def test_status_and_log_follow_a_live_run(exmesh: Exmesh, folder: Path) -> None:
    words = ["run", "g.yaml", "--tokens", "cpu=2", "--workers", "2"]
    for name, steps in (("s", 600), ("t", 601)):  # with 600 it would be the same node, and wait for the result
        words += ["--set", f"{name}.seconds=60", "--set", f"{name}.steps={steps}"]
    process = subprocess.Popen([*START, *words], cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True)
    follower = None
    try:
        events = folder / "runs" / "latest" / "events.jsonl"
        wait_for(lambda: events.exists() and all(f'"node": "{n}", "step": ' in events.read_text() for n in "st"))
        lines = exmesh("status").stdout.splitlines()
        assert lines[0].startswith("running")
        assert "2/6 nodes" in lines[0]
        assert sorted(line.split()[0] for line in lines[1:3]) == ["s", "t"]
        assert all("/60" in line and "left" in line for line in lines[1:3])
        follower = subprocess.Popen(
            [*START, "log", "-f"], cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True
        )
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        shown = process.communicate(timeout=30)[0]
        assert "stopping" in shown
        assert "\x1b" not in shown
        followed = follower.communicate(timeout=30)[0]
        assert "s  starts" in followed
        assert "interrupted after" in followed
    finally:
        for each in filter(None, (process, follower)):
            each.kill()
            each.wait()
    assert exmesh("status").stdout.split()[0] == "interrupted"


@pytest.mark.slow
def test_the_terminal_shows_all_running_nodes(folder: Path) -> None:
    parent, child = pty.openpty()
    env = {k: v for k, v in environment().items() if k != "NO_COLOR"} | {"TERM": "xterm-256color"}
    words = ["run", "g.yaml", "--set", "s.seconds=1.5", "--set", "t.seconds=2", "--tokens", "cpu=2", "--workers", "2"]
    process = subprocess.Popen([*START, *words], cwd=folder, env=env, stdout=child, stderr=child)
    os.close(child)
    shown = b""
    while True:
        try:
            part = os.read(parent, 65536)
        except OSError:
            break
        if not part:
            break
        shown += part
    assert process.wait() == 0
    frames = shown.decode().split("to go,")
    assert any("toy.slow" in f and f.count("\u2501") > 10 and " s " in f and " t " in f for f in frames)


def test_times_left() -> None:
    busy = RunningNode(10.0, {"time": 14.0, "event": "progress", "node": "n", "step": 60, "total": 100}, (12.0, 40))
    assert busy.left(14.0) == pytest.approx(4.0)  # 20 steps in 2 s; a resumed node does not count its old steps
    assert busy.left(15.0) == pytest.approx(3.0)
    board = Board()
    for event in (
        {"time": 0.0, "event": "run_started", "run": "r", "nodes": ["a", "b", "c", "d"]},
        {"time": 0.0, "event": "expected", "seconds": {"a": 10.0, "b": 6.0, "c": 8.0}},
        {"time": 0.0, "event": "node_started", "node": "a"},
    ):
        board.take(event)
    assert board.left(2.0) is None  # d never ran
    board.take({"time": 2.0, "event": "node_finished", "node": "d", "state": "hit", "seconds": 1.0})
    assert board.left(2.0) == pytest.approx(8.0 + 6.0 + 8.0)
    board.take({"time": 2.0, "event": "node_started", "node": "b"})
    assert board.left(2.0) == pytest.approx((8.0 + 6.0 + 8.0) / 2)
    board.take({"time": 3.0, "event": "something_new"})
    assert board.count("running") == 2
