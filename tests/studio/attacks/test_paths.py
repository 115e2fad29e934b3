"""Paths and links that would lead a studio out of the graph's folder, its runs and its store."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.workspace import Workspace

OUT = (
    "../../../../etc/passwd",
    "..%2f..%2f..%2fetc%2fpasswd",
    "/etc/passwd",
    "....//....//etc/passwd",
    "%2e%2e/app.py",
    "..\\..\\app.py",
    "index.html%00.py",
    "../serving.py",
    "~/.bashrc",
)


@pytest.mark.thorough
@pytest.mark.reliability("studio: path tricks in the page's files", "404")
@pytest.mark.parametrize("path", OUT)
def test_paths_out_of_the_pages_files(client: TestClient, path: str) -> None:
    for home in ("/static/", "/assets/"):
        answer = client.get(home + path)
        assert answer.status_code == 404
        assert "root:" not in answer.text


@pytest.mark.thorough
@pytest.mark.reliability("studio: path tricks in names of runs, artifacts, lights and graphs", "404, nothing opened")
@pytest.mark.parametrize("name", ["..", ".", "../runs", "..%2f..", "/etc", "a/b", "latest", "C:\\x"])
def test_paths_in_names(client: TestClient, folder: Path, name: str) -> None:
    (folder / "secret.yaml").write_text("nodes: {one: {type: toy.const}}\n")
    assert client.get(f"/api/runs/{name}").status_code in (200, 404)  # `..` leads to /api, `.` to the list
    assert client.post("/api/runs/stop", json={"id": name}).status_code == 404
    assert client.post("/api/runs/resume", json={"id": name}).status_code == 404
    assert client.get("/api/artifact", params={"digest": name}).status_code in (400, 404)
    assert client.get("/api/light", params={"name": name}).status_code == 404
    for file in (name, f"{name}/secret.yaml", f"{name}.yaml"):
        assert client.post("/api/open", json={"file": file}).status_code == 404


@pytest.mark.reliability("studio: links out of the graph's folder, to graphs and to folders", "404, not listed")
def test_links_out_of_the_folder(client: TestClient, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside")
    (outside / "secret.yaml").write_text("# secret\nnodes: {one: {type: toy.const}}\n")
    (folder / "graphs" / "link.yaml").symlink_to(outside / "secret.yaml")
    (folder / "graphs" / "sub").symlink_to(outside)
    for file in ("link.yaml", "sub/secret.yaml"):
        assert client.post("/api/open", json={"file": file}).status_code == 404
    assert [one["file"] for one in client.get("/api/graphs").json()["graphs"]] == ["small.yaml"]
    saved = client.post("/api/save", json={"as": "child", "file": "sub/new.yaml"})
    assert saved.status_code == 404
    assert [path.name for path in outside.iterdir()] == ["secret.yaml"]


@pytest.mark.reliability(
    "studio: run folders that are links, or hold links and pipes",
    "not shown, or unreadable; nothing outside read",
)
def test_run_folders_from_elsewhere(client: TestClient, workspace: Workspace, folder: Path) -> None:
    secret = folder / "secret"
    secret.mkdir()
    (secret / "run.json").write_text('{"state": "done", "nodes": [], "started": 0, "graph": "secret"}')
    (secret / "events.jsonl").write_text("")
    runs = folder / "runs"
    runs.mkdir()
    (runs / "linked").symlink_to(secret)
    for name in ("piped", "leads", "mine"):
        (runs / name).mkdir()
    (runs / "piped" / "run.json").write_text("{}")
    os.mkfifo(runs / "piped" / "events.jsonl")  # opening it would wait for ever
    (runs / "leads" / "run.json").symlink_to(secret / "run.json")
    (runs / "leads" / "events.jsonl").write_text("")
    (runs / "mine" / "run.json").write_text(
        '{"state": "failed", "nodes": [{"name": "n", "state": "failed"}], "started": 0}'
    )
    (runs / "mine" / "events.jsonl").write_text("")
    (runs / "mine" / "logs").mkdir()
    (runs / "mine" / "logs" / "n.log").symlink_to("/etc/passwd")
    (runs / "mine" / "report.html").symlink_to("/etc/passwd")
    (runs / "mine" / "failures").symlink_to("/etc")
    workspace.watcher._listed = 0
    workspace.watcher.look()
    assert [run["id"] for run in client.get("/api/runs").json()["runs"]] == ["mine"]
    assert client.get("/api/runs/mine/log", params={"node": "n"}).json()["lines"] == []
    assert client.get("/api/runs/mine/report").status_code == 404
    assert client.get("/api/runs/mine").json()["nodes_detail"][0]["failure"] is None
