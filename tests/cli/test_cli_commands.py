"""The `exmesh` command as its users meet it: a subprocess, a folder, a toy node pack."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.language.check import check, check_file
from exmesh_graph.graph.language.expand import expand
from exmesh_graph.graph.language.spec import load_tree
from exmesh_graph.graph.problems import GraphErrors, Problems

TOY = Path(__file__).parent.parent / "graph" / "toy"
START = [sys.executable, "-c", "from exmesh_graph.cli import main; main()"]

GRAPH = """
name: toys
params: {n: 2}
nodes:
  one: {type: toy.const, value: 1}
  rounds:
    repeat: "${n}"
    carry: {state: "@one.number"}
    nodes: {step: {type: toy.step, state: "@carry.state", amount: 2}}
    next: {state: "@step.state"}
  slow: {type: toy.slow, number: "@rounds.state", seconds: 0}
  files: {type: toy.folder, number: "@slow.number"}
  figures: {type: toy.metrics, number: "@slow.number"}
outputs: {asset: "@files.files"}
"""

Exmesh = Callable[..., Any]  # of conftest.py


def environment() -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(TOY), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "100", "NO_COLOR": "1"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "g.yaml").write_text(GRAPH)
    return tmp_path


@pytest.fixture
def fresh_exmesh(folder: Path) -> Exmesh:
    """The command in a process of its own."""

    def call(*words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [*START, *words], cwd=folder, env=environment(), capture_output=True, text=True, check=False
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done

    return call


def test_check_lists_what_choices_set(exmesh: Exmesh, folder: Path) -> None:
    text = "params: {pick: {default: a, choices: {a: {}, b: {v: 3, w: 4}}}, v: 1, w: 2}\n"
    (folder / "choices.yaml").write_text(text + "nodes: {x: {type: toy.const, value: '${v}'}}")
    said = exmesh("check", "choices.yaml", "--set", "pick=b", "--set", "w=5").stdout
    assert "  pick = 'b'  (any, one of a, b)\n      b: v = 3, w = 4\n  v = 3\n  w = 5\n" in said


@pytest.mark.thorough
def test_from_check_to_report(exmesh: Exmesh, folder: Path) -> None:
    assert "6 nodes, 0 source files, no faults" in exmesh("check", "g.yaml").stdout
    first = exmesh("run", "g.yaml").stdout
    assert "[1/6] done one  toy.const" in first
    assert "6 nodes, 0 from the store, 6 run" in first
    assert "asset: runs/" in first
    assert "report: runs/" in first
    latest = folder / "runs" / "latest"
    assert (latest / "number.txt").read_text() == "5.0"
    assert "toys" in (latest / "report.html").read_text()
    assert json.loads((latest / "report.json").read_text())
    second = exmesh("run", "g.yaml").stdout
    assert "6 from the store, 0 run" in second
    assert "6 hit, 0 to run" in exmesh("plan", "g.yaml").stdout
    assert "0 moved to quarantine" in exmesh("verify").stdout
    lines = exmesh("status").stdout.splitlines()
    assert len(lines) == 2
    assert "6/6 nodes, 6 hits" in lines[0]
    (latest / "report.html").unlink()
    exmesh("report", "runs/latest")
    assert (latest / "report.html").exists()


@pytest.mark.thorough
def test_plan_and_why_give_reasons(exmesh: Exmesh, folder: Path) -> None:
    assert "no earlier run of toy.const" in exmesh("plan", "g.yaml").stdout
    exmesh("run", "g.yaml", "--set", "rounds.step.amount=3")
    shown = exmesh("plan", "g.yaml").stdout
    assert "parameter amount: 3 -> 2" in shown
    assert "waits for rounds[1].step" in shown
    why = exmesh("why", "rounds[1].step", "g.yaml").stdout
    assert "run" in why
    assert "parameter amount: 3 -> 2" in why
    assert "toy_pack.nodes:step" in why
    assert "rounds[1].step: hit" in exmesh("why", "rounds[1].step").stdout  # as the latest run was
    assert "rounds[1].step" in exmesh("why", "rounds[1].stp", "g.yaml", code=2).stderr


def test_nodes(exmesh: Exmesh) -> None:
    assert "toy.slow" in exmesh("nodes").stdout
    shown = exmesh("nodes", "toy.const").stdout
    assert "value: float = 1.0 apples  (>= -1000, <= 1000)  The number." in shown
    assert "not part of the key" in shown
    assert "number: Number[split='train']" in exmesh("nodes", "toy.train_only").stdout
    assert "toy.const" in exmesh("nodes", "toy.cnst", code=1).stderr


def test_graph_errors_come_all_at_once(exmesh: Exmesh, folder: Path) -> None:
    text = GRAPH.replace("toy.const", "toy.cnst").replace("@carry.state", "@carry.stat").replace("seconds", "secnds")
    (folder / "g.yaml").write_text(text)
    for command in ("check", "plan", "run"):
        shown = exmesh(command, "g.yaml", code=2).stderr
        assert "g.yaml:5: [node-type] one: there is no node type 'toy.cnst'" in shown
        assert "rounds carries no 'stat'" in shown
        assert "slow: toy.slow has no parameter 'secnds'" in shown
    assert not (folder / "runs").exists()


@pytest.mark.thorough
def test_failure_says_what_to_do(exmesh: Exmesh, folder: Path) -> None:
    bad = '\n  bad: {type: toy.fail, number: "@slow.number", value: 9}\nrun: all\noutputs'
    (folder / "g.yaml").write_text(GRAPH.replace("\noutputs", bad))
    failed = exmesh("run", "g.yaml", "--set", "n=2", code=1)
    assert "failed: bad: toy: the number is too small" in failed.stderr
    assert "expected: above 9.0" in failed.stderr
    assert "fix: raise it" in failed.stderr
    assert "exmesh run g.yaml --set n=2 --node bad" in failed.stderr
    assert (folder / "runs" / "latest" / "failure.json").exists()
    assert "failed" in exmesh("status").stdout
    exmesh("run", "g.yaml", "--set", "n=2", "--node", "bad", code=1)
    assert "0 moved" in exmesh("verify").stdout
    assert "6 from the store, 1 run" in exmesh("run", "g.yaml", "--set", "bad.value=1").stdout


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_cleanly_and_the_same_command_resumes(exmesh: Exmesh, folder: Path, number: int) -> None:
    words = ["run", "g.yaml", "--set", "slow.seconds=60", "--set", "slow.steps=600"]
    process = subprocess.Popen(
        [*START, *words], cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    events = folder / "runs" / "latest" / "events.jsonl"
    wait_for(lambda: events.exists() and '"progress"' in events.read_text())
    assert "running" in exmesh("status").stdout
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted; go on with the same command:" in errors
    assert "exmesh run g.yaml --set slow.seconds=60 --set slow.steps=600" in errors
    assert json.loads((folder / "runs" / "latest" / "run.json").read_text())["state"] == "interrupted"
    assert "interrupted" in exmesh("status").stdout
    assert "0 moved" in exmesh("verify").stdout
    assert list((folder / ".exmesh" / "work").iterdir()) == []
    assert "3 from the store, 3 run" in exmesh("run", "g.yaml", "--set", "slow.seconds=0").stdout


@pytest.mark.thorough
def test_a_killed_run_is_called_killed(exmesh: Exmesh, folder: Path) -> None:
    process = subprocess.Popen(
        [*START, "run", "g.yaml", "--set", "slow.seconds=60"], cwd=folder, env=environment(), stdout=subprocess.DEVNULL
    )
    events = folder / "runs" / "latest" / "events.jsonl"
    wait_for(lambda: events.exists() and '"node_started", "node": "slow"' in events.read_text())
    process.kill()
    process.wait()
    assert "killed" in exmesh("status").stdout
    assert "3 from the store, 3 run" in exmesh("run", "g.yaml").stdout


@pytest.mark.thorough
def test_store_and_runs_can_be_elsewhere(exmesh: Exmesh, folder: Path) -> None:
    exmesh("run", "g.yaml", "--store", "s", "--runs", "r")
    assert (folder / "s" / "objects").is_dir()
    assert (folder / "r" / "latest" / "run.json").exists()
    assert not (folder / ".exmesh").exists()
    (folder / "s").rename(folder / "t")
    assert "6 from the store" in exmesh("run", "g.yaml", "--store", "t", "--runs", "r").stdout


@pytest.mark.thorough
def test_a_changed_helper_is_run_again(fresh_exmesh: Exmesh, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exmesh = fresh_exmesh
    copy = folder / "pack"
    shutil.copytree(TOY, copy)
    monkeypatch.setattr(sys.modules[__name__], "TOY", copy)
    (folder / "g.yaml").write_text('nodes: {a: {type: toy.const}, s: {type: toy.sign, number: "@a.number"}}')
    exmesh("run", "g.yaml")
    helper = copy / "toy_pack" / "helpers.py"
    text = helper.read_text()
    helper.write_text(text.replace('"""1 for', '# a comment\n    """One for'))
    assert "2 hit, 0 to run" in exmesh("plan", "g.yaml").stdout
    helper.write_text(text.replace("1.0 if value", "2.0 if value"))
    assert "code changed: toy_pack.helpers" in exmesh("plan", "g.yaml").stdout
    assert "1 from the store, 1 run" in exmesh("run", "g.yaml").stdout


@pytest.mark.thorough
def test_a_broken_pack_module_does_not_stop_others(
    fresh_exmesh: Exmesh, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exmesh = fresh_exmesh
    copy = folder / "pack"
    shutil.copytree(TOY, copy)
    (copy / "toy_pack" / "wrong.py").write_text("import does_not_exist\n")
    monkeypatch.setattr(sys.modules[__name__], "TOY", copy)
    shown = exmesh("nodes").stderr
    assert "toy_pack.wrong cannot be imported: ModuleNotFoundError" in shown
    assert "toy_pack/wrong.py:1)" in shown
    exmesh("run", "g.yaml")
    (folder / "g.yaml").write_text("nodes: {a: {type: toy.wrong}}")
    assert "toy_pack.wrong cannot be imported: ModuleNotFoundError" in exmesh("check", "g.yaml", code=2).stderr


@pytest.mark.slow
def test_terminal_view(folder: Path) -> None:
    """On a terminal the run draws a live table; it must at least end with the states and the summary."""
    parent, child = pty.openpty()
    env = {k: v for k, v in environment().items() if k != "NO_COLOR"} | {"TERM": "xterm-256color"}
    words = ["run", "g.yaml", "--set", "slow.seconds=1", "--set", "slow.steps=20"]
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
    text = shown.decode()
    for word in ("rounds[1].step", "toy.slow", "loss", "left", "0 of 6 to go", "6 nodes, 0 from the store"):
        assert word in text


ROOT = Path(__file__).parent.parent.parent


GRAPHS = sorted((ROOT / "graphs").rglob("*.yaml"))


def test_every_part_is_used_by_a_shipped_graph() -> None:
    texts = "".join(path.read_text() for path in GRAPHS if path.parent.name != "parts")
    assert [
        path.name for path in GRAPHS if path.parent.name == "parts" and f"graph: parts/{path.name}" not in texts
    ] == []


@pytest.mark.thorough
@pytest.mark.parametrize("path", [p for p in GRAPHS if p.parent.name != "parts"], ids=lambda path: path.stem)
def test_shipped_graphs_lack_at_most_their_data(path: Path) -> None:
    found = Problems()
    declared = (YAML(typ="safe").load(path.read_text()).get("params") or {}).items()
    given = [
        f"{name}=nowhere"
        for name, p in declared
        if isinstance(p, dict) and p.get("type") == "path" and "default" not in p
    ]
    tree = load_tree(path, given, found)
    with contextlib.suppress(GraphErrors):
        check(expand(tree, found), load_packs(), found)
    optional = re.compile("needs the library (pycolmap|depth-anything-3)")  # extras that the test line does not install
    problems = [str(problem) for problem in found.noted.values() if problem.code != "source"]
    problems = [problem for problem in problems if not optional.search(problem)]
    assert problems == []


PROBE = """
import sys
from exmesh_graph.cli import main
sys.argv[:1] = ["exmesh", "run", "g.yaml"]
try:
    main()
except SystemExit as end:
    assert not end.code
print("LOADED", *[name for name in ("torch", "open3d", "scipy", "skimage", "warp", "pxr") if name in sys.modules])
"""


@pytest.mark.slow
def test_a_run_of_nothing_but_hits_loads_nothing_heavy(folder: Path) -> None:
    scene = ROOT / "graphs" / "samples" / "spot"
    (folder / "g.yaml").write_text(
        f"nodes:\n  views: {{type: data.blender, path: {scene}, downscale: 8, max_views: 4}}\n"
        '  hull: {type: init.visual_hull, views: "@views.train", resolution: 16}\n'
    )
    shown = []
    for options in (["--workers", "0"], []):  # the nodes in this process, then nothing but hits
        words = [sys.executable, "-c", PROBE, *options]
        done = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        shown.append(done.stdout)
    assert "scipy" in shown[0].split("LOADED")[1]
    assert "2 from the store, 0 run" in shown[1]
    assert shown[1].split("LOADED")[1].split() == []


def test_the_graph_in_the_docs(folder: Path) -> None:
    text = (ROOT / "docs" / "graph_files.md").read_text().split("```yaml\n")[1].split("```")[0]
    (folder / "base.yaml").write_text("nodes: {}\n")
    (folder / "doc.yaml").write_text(text)
    graph = check_file(folder / "doc.yaml", [f"scene={ROOT}/graphs/samples/spot"], load_packs())
    assert graph.nodes["rounds[4].uv"].definition.type == "uv.regenerate"
    assert str(graph.nodes["light"].inputs["mesh"]) == "@rounds[4].uv.state"


def wait_for(condition: Callable[[], bool], seconds: float = 20) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_old_names_are_told_of_once_by_each_command(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text("nodes:\n  a:\n    type: toy.constant\n    text: x\noutputs: {a: '@a.number'}\n")
    for words in (["check"], ["plan"], ["run", "--workers", "0"]):
        lines = [line for line in exmesh(words[0], "g.yaml", *words[1:]).stderr.splitlines() if "warning" in line]
        assert lines == [
            "warning: g.yaml:3: the node type 'toy.constant' is now called 'toy.const'; "
            "the old name goes with the next release",
            "warning: g.yaml:4: toy.const: 'text' is now called 'label'; the old name goes with the next release",
        ]
