"""What programs read and ask for: --json of plan, nodes, why, status; get; --version; completion."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

GRAPH = """
name: g
nodes:
  one: {type: toy.const, value: 1}
  two: {type: toy.step, state: "@one.number", amount: 2}
  files: {type: toy.folder, number: "@two.state"}
"""


def test_json_of_plan_why_status_and_nodes(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH)
    before = json.loads(exmesh("plan", "g.yaml", "--json").stdout)
    assert (before["schema"], before["graph"], before["counts"]) == (
        "exmesh.plan.v1",
        "g",
        {"hit": 0, "run": 1, "unknown": 2, "idle": 0},
    )
    assert before["steps"][0].keys() == {"name", "type", "state", "reason", "key"}
    exmesh("run", "g.yaml", "--workers", "0")
    assert json.loads(exmesh("plan", "g.yaml", "--json").stdout)["counts"]["hit"] == 3
    why = json.loads(exmesh("why", "two", "--set", "two.amount=3", "--json").stdout)
    assert (why["schema"], why["node"], why["state"]) == ("exmesh.why.v1", "two", "run")
    assert why["lines"] == ["parameter amount: 2 -> 3"]
    assert why["depends_on"]["params"] == ["amount"]
    status = json.loads(exmesh("status", "--json").stdout)
    assert status["schema"] == "exmesh.status.v1"
    (run,) = status["runs"]
    assert (run["state"], run["nodes"], run["ready"], run["hits"], run["running"]) == ("done", 3, 3, 0, {})
    nodes = json.loads(exmesh("nodes", "toy.step", "--json").stdout)
    assert nodes["schema"] == "exmesh.nodes.v1"
    (told,) = nodes["types"]
    assert (told["type"], told["component"], told["inputs"][0]["type"]) == ("toy.step", False, "Number")
    assert told["parameters"][0].keys() == {"name", "type", "default", "limits", "unit", "doc", "tuning"}
    assert len(json.loads(exmesh("nodes", "--json").stdout)["types"]) > 60


def test_get_copies_an_artifact(exmesh: Any, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH)
    exmesh("run", "g.yaml", "--workers", "0")
    shown = exmesh("get", "two.state").stdout
    assert shown.startswith("two.state: Number, ")
    assert (tmp_path / "two.state" / "number.json").is_file()
    exmesh("get", "files.files", "--run", "runs/latest", "--out", "there")
    assert (tmp_path / "there" / "files" / "number.txt").read_text() == "3.0"
    assert "two" in exmesh("get", "tow.state", code=1).stderr
    assert "state" in exmesh("get", "two.stat", code=1).stderr


def test_version_and_completion(exmesh: Any) -> None:
    from exmesh_graph import __version__

    assert exmesh("--version").stdout == f"exmesh {__version__}\n"
    assert "--install-completion" in exmesh("--help").stdout


def test_stubs_are_printed_and_written(exmesh: Any, tmp_path: Path) -> None:
    exmesh("stubs", "-o", "families.pyi")
    assert (tmp_path / "families.pyi").read_text() == exmesh("stubs").stdout
