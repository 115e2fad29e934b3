"""Where a run comes from, and what differs between two."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import exmesh_graph as ex
from exmesh_graph.api.provenance import commit_of, differences

GRAPH = "nodes: {one: {type: toy.const}}\n"


def git(folder: Path, *words: str) -> str:
    own = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", *own, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


def test_a_run_tells_commit_libraries_machine_and_command(folder: Path) -> None:
    (folder / "graph.yaml").write_text(GRAPH)
    git(folder, "init", "-q")
    git(folder, "add", "graph.yaml")
    git(folder, "commit", "-q", "-m", "a")
    first = ex.run("graph.yaml", workers=0, report=False)
    told = first.record["provenance"]
    assert told["project"] == {"commit": git(folder, "rev-parse", "HEAD"), "dirty": False}
    assert told["command"] == "exmesh run graph.yaml --workers 0"
    assert told["libraries"]["numpy"] != "not installed"
    assert told["machine"]["processor"]
    assert json.loads((first.folder / "provenance.json").read_text()) == told
    assert json.loads((first.folder / "run.json").read_text())["provenance"] == told
    (folder / "graph.yaml").write_text(GRAPH + "# a change\n")
    second = ex.run("graph.yaml", workers=0, report=False)
    assert second.record["provenance"]["project"]["dirty"] is True
    assert second["one"].info["state"] == "hit"  # none of it is in a key
    commit = told["project"]["commit"][:12]
    assert f"project commit: {commit} -> {commit} (with changes)" in str(ex.diff(first, second))
    assert "commit" not in str(ex.diff(first, first))


def test_what_differs_is_said_once_and_older_runs_say_nothing(folder: Path) -> None:
    old = {"machine": {"processor": "A", "torch": "2.4"}, "libraries": {"numpy": "1"}, "gpus": [], "command": "x"}
    new = {"machine": {"processor": "B", "torch": "2.4"}, "libraries": {"numpy": "2"}, "gpus": ["C"], "command": "y"}
    assert list(differences(old, new)) == ["processor: A -> B", "numpy: 1 -> 2", "gpus: none -> C"]
    assert commit_of(folder) == {}
