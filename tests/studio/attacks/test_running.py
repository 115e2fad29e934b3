"""What looking at graphs and records from elsewhere runs: nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.workspace import Workspace


def edit(client: TestClient, *ops: Any) -> Any:
    return client.post("/api/edit", json={"ops": list(ops)})


@pytest.mark.reliability(
    "studio: a record with a command or a file of its own is gone on with", "404, 422; nothing run"
)
@pytest.mark.parametrize("file", ["/etc/passwd", "../secret.yaml", "$(touch pwned).yaml", "small.yaml; touch pwned"])
def test_records_cannot_choose_what_runs(client: TestClient, workspace: Workspace, folder: Path, file: str) -> None:
    home = folder / "runs" / "odd"
    home.mkdir(parents=True)
    record = {
        "state": "failed",
        "nodes": [],
        "started": 0,
        "file": file,
        "command": "touch pwned; exmesh run",
        "overrides": ["$(touch pwned)"],
        "resolved": {"nodes": {}, "variant": "`touch pwned`"},
    }
    (home / "run.json").write_text(json.dumps(record))
    (home / "events.jsonl").write_text("")
    assert client.post("/api/runs/resume", json={"id": "odd"}).status_code == 404
    assert not list(folder.rglob("pwned"))
    assert not list((folder / ".exmesh").rglob("job.json"))


@pytest.mark.reliability(
    "studio: types that are modules, functions or paths; code in YAML of the folder", "a fault, nothing run"
)
def test_looking_runs_no_code(client: TestClient, folder: Path) -> None:
    for kind in ("os.system", "subprocess:run", "../evil", "__import__('os')", "toy_pack.const"):
        answer = edit(client, {"add": {"name": "evil", "type": kind, "value": "touch pwned"}})
        assert answer.status_code == 422
    bad = folder / "graphs" / "bad.yaml"
    bad.write_text("nodes: {a: !!python/object/apply:os.system ['touch pwned']}\n")
    told = client.post("/api/open", json={"file": "bad.yaml"}).json()
    assert "tag" in told["problems"][0]["what"]
    assert client.post("/api/runs", json={}).status_code == 422
    assert client.post("/api/open", json={"file": "small.yaml"}).status_code == 200
    assert not list(folder.rglob("pwned"))


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: YAML bombs, endless rounds and files that extend themselves are opened", "told as faults, at once"
)
@pytest.mark.parametrize(
    "text",
    [
        "".join(f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n" for a, b in ["ab", "bc", "cd", "de"]).replace("*a", "x"),
        "extends: bomb.yaml\nnodes: {}\n",
        "nodes: {r: {repeat: 100000, carry: {}, nodes: {a: {type: toy.const}}, next: {}}}\n",
        "nodes: " + "{a: " * 500 + "1" + "}" * 500,
        "nodes: {a: {graph: bomb.yaml}}\n",
        "\0\0\0",
        "- 1\n- 2\n",
    ],
)
def test_bombs(client: TestClient, folder: Path, text: str) -> None:
    (folder / "graphs" / "bomb.yaml").write_text(text)
    told = client.post("/api/open", json={"file": "bomb.yaml"})
    assert told.status_code == 200
    assert told.json()["problems"]
    assert client.post("/api/open", json={"file": "small.yaml"}).status_code == 200
