"""Runs in processes of their own: started, watched, stopped, gone on with; sweeps and comparisons."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.testclient import TestClient

import exmesh_graph as ex
from exmesh_graph.studio.workspace import Workspace

SLOW = """\
name: slow
nodes:
  one: {type: toy.const, value: 1}
  wait: {type: toy.slow, number: "@one.number", seconds: 60, steps: 600}
"""


def until(done: Callable[[], Any], seconds: float = 60.0) -> Any:
    """What `done` gives once it gives something."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := done():
            return found
        time.sleep(0.1)
    raise AssertionError("it did not happen in time")


def run_of(client: httpx.Client, answer: Any) -> str:
    """The id of the run that an answer tells of, once there is one."""
    assert answer.status_code == 202, answer.text
    told = answer.json()["run"]["id"]
    return str(told or until(lambda: next((r["id"] for r in client.get("/api/runs").json()["runs"] if r["ours"]), "")))


def ended(client: httpx.Client, name: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        told = client.get(f"/api/runs/{name}").json()
        return told if told["state"] not in ("running", "stopping", "starting") else None

    return dict(until(look))


def test_a_run_that_is_over_when_it_is_first_seen_makes_a_new_plan(workspace: Workspace) -> None:
    before = workspace.plan()
    assert before is not None
    assert before["counts"]["hit"] == 0
    ex.run(workspace.file, store=workspace.store_folder, runs=workspace.runs, workers=0, progress=False)
    workspace.watcher.look()
    after = workspace.plan()
    assert after is not None
    assert (after["counts"]["run"], after["counts"]["unknown"]) == (0, 0)


@pytest.mark.thorough
def test_a_run_of_edits_and_a_sweep_of_what_is_marked(client: TestClient, folder: Path) -> None:
    client.post("/api/edit", json={"ops": [{"set": "one.value", "to": 5}, {"set": "n", "to": 2}]})
    name = run_of(client, client.post("/api/runs", json={"workers": 0}))
    told = ended(client, name)
    assert (told["state"], told["ours"], told["nodes"]) == ("done", True, 7)
    assert told["nodes_detail"][0]["outputs"]["number"]["type"] == "Number"
    assert Path(told["file"]).parent == folder / ".exmesh" / "studio" / "graphs"
    assert (folder / "graphs" / "small.yaml").read_text().count("value: 1")  # what is on disk was not touched
    until(lambda: client.get("/api/plan").json()["plan"]["counts"]["run"] == 0)
    plan = client.get("/api/plan").json()["plan"]
    assert plan["counts"] == {"hit": 7, "run": 0, "unknown": 0}
    digest = plan["nodes"]["sum"]["rounds"][0]["outputs"]["number"]["digest"]
    assert client.get("/api/artifact", params={"digest": digest}).json()["type"] == "Number"
    log = client.get(f"/api/runs/{name}/log", params={"node": "one"}).json()
    assert [line["text"].split()[0] for line in log["lines"]] == ["starts", "done"]

    marked = client.post("/api/ablation", json={"nodes": ["rounds.leap", "sum.b", "one"], "repeats": 1}).json()
    assert [(one["name"], one["how"]) for one in marked["variants"]] == [
        ("no_leap", "bypassed"), ("no_b", "disconnected"), ("no_one", "refused"),
    ]  # fmt: skip
    assert "cannot be bypassed" in marked["variants"][2]["why"]
    assert [one["name"] for one in marked["plan"]["variants"]] == ["base", "no_leap", "no_b"]
    swept = run_of(client, client.post("/api/sweep", json={"nodes": ["rounds.leap", "sum.b"], "workers": 0}))
    assert ended(client, swept)["state"] == "done"
    table = until(lambda: client.get(f"/api/runs/{swept}/sweep").json().get("table"))
    assert [row["variant"] for row in table["rows"]] == ["base", "no_leap", "no_b"]
    page = until(lambda: (a := client.get(f"/api/runs/{swept}/sweep.html")).status_code == 200 and a)
    assert "sandbox" in page.headers["content-security-policy"]

    pair = client.get("/api/compare", params={"a": name, "b": swept}).json()
    assert {one["name"]: one["same"] for one in pair["nodes"]}["one"] is True
    client.post("/api/runs/label", json={"id": name, "label": "five\u0007 <b>"})
    assert client.get(f"/api/runs/{name}").json()["label"] == "five <b>"


def test_a_run_is_drawn_as_it_ran_whatever_became_of_its_file(client: TestClient, folder: Path) -> None:
    file = folder / "graphs" / "small.yaml"
    run = ex.run(file, workers=0, progress=False, store=folder / ".exmesh", runs=folder / "runs", set={"n": 2})
    document = client.get("/api/document").json()
    file.write_text("nodes: {other: {type: toy.const}}\n")
    until(lambda: client.get(f"/api/runs/{run.id}").status_code == 200)
    told = client.get(f"/api/runs/{run.id}/graph").json()
    key = [(tuple(wire["from"]), tuple(wire["to"])) for wire in document["wires"]]
    assert sorted((tuple(wire["from"]), tuple(wire["to"])) for wire in told["wires"]) == sorted(key)
    assert {node["id"]: node["kind"] for node in told["nodes"]} == {n["id"]: n["kind"] for n in document["nodes"]}
    nodes = {node["id"]: node for node in told["nodes"]}
    assert nodes["rounds.step"]["names"] == ["rounds[1].step", "rounds[2].step"]
    assert (nodes["rounds"]["repeat"], nodes["rounds.step"]["given"]) == (2, {"amount": {"value": 2}})
    assert nodes["rounds.leap"]["differ"] == ["factor"]
    assert told["outputs"] == [{"name": "asset", "node": "files", "port": "files", "text": "@files.files"}]
    assert client.get("/api/runs/none/graph").status_code == 404


def test_a_run_is_stopped_and_its_failure_told(client: TestClient, workspace: Workspace, folder: Path) -> None:
    (folder / "graphs" / "slow.yaml").write_text(SLOW)
    assert client.post("/api/open", json={"file": "slow.yaml"}).status_code == 200
    name = run_of(client, client.post("/api/runs", json={}))
    until(lambda: client.get(f"/api/runs/{name}/curves").json()["curves"])
    (detail,) = [n for n in client.get(f"/api/runs/{name}").json()["nodes_detail"] if n["name"] == "wait"]
    assert detail["state"] == "running"
    assert detail["progress"]["total"] == 600
    assert client.post("/api/runs/stop", json={"id": name}).json()["run"]["state"] == "stopping"
    told = ended(client, name)
    assert told["state"] == "interrupted"
    assert told["can_resume"]
    assert client.post("/api/runs/stop", json={"id": name}).status_code == 422  # nobody writes it now


def test_runs_started_elsewhere_are_seen_and_replayed(client: TestClient, folder: Path) -> None:
    graph = ex.Graph("elsewhere")
    one = graph.add("one", "toy.const", value=1)
    graph.add("bad", "toy.fail", number=one.number, value=5)
    try:
        ex.run(graph, workers=0, progress=False, store=folder / ".exmesh", runs=folder / "runs")
    except ex.RunFailed as failure:
        name = failure.run.id
    until(lambda: next((r for r in client.get("/api/runs").json()["runs"] if r["id"] == name), None))
    told = ended(client, name)
    assert (told["state"], told["ours"], told["failed"]) == ("failed", False, ["bad"])
    (bad,) = [n for n in client.get(f"/api/runs/{name}").json()["nodes_detail"] if n["name"] == "bad"]
    assert "the number is too small" in bad["failure"]["message"]
    assert bad["failure"]["replay"].startswith("exmesh replay ")


def test_a_record_that_somebody_broke_is_unreadable_and_no_more(client: TestClient, folder: Path) -> None:
    for number, text in enumerate(["{", "[]", '{"state": 1, "nodes": 3, "started": "x"}', json.dumps({"nodes": {}})]):
        broken = folder / "runs" / f"2026-{number}"
        broken.mkdir(parents=True)
        (broken / "run.json").write_text(text)
        (broken / "events.jsonl").write_bytes(b'\xff\xfe{"event": 3}\nnull\n{"event": "progress", "time": 1}\n')

    def listed() -> list[Any]:
        found = [r for r in client.get("/api/runs").json()["runs"] if r["id"].startswith("2026-")]
        return found if len(found) == 4 else []

    assert {run["state"] for run in until(listed)} == {"unreadable"}


@pytest.mark.slow
@pytest.mark.reliability(
    "studio: the server is killed while a run of its own goes on", "the run goes on; the next one sees and stops it"
)
def test_a_run_outlives_its_server(folder: Path) -> None:
    (folder / "graphs" / "slow.yaml").write_text(SLOW)
    words = [
        sys.executable,
        "-c",
        "from exmesh_graph.cli import main; main()",
        "studio",
        "graphs/slow.yaml",
        "--no-browser",
    ]
    server = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    address = next(line for line in server.stdout if "http://" in line).split()[-1]
    with httpx.Client(base_url=address.partition("?")[0], headers={"x-exmesh": "1"}, timeout=60) as page:
        assert page.get(f"/?{address.partition('?')[2]}").status_code == 303
        name = run_of(page, page.post("/api/runs", json={}))
        until(lambda: page.get(f"/api/runs/{name}/curves").json()["curves"])
        server.kill()
        server.wait()
        again = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True)
        assert again.stdout is not None
        assert next(line for line in again.stdout if "http://" in line).split()[-1].partition("?")[0] == str(
            page.base_url
        )
        told = page.get(f"/api/runs/{name}").json()  # with the cookie that it had
        assert (told["state"], told["ours"]) == ("running", True)
        assert page.post("/api/runs/stop", json={"id": name}).status_code == 200
        assert ended(page, name)["state"] == "interrupted"
        again.terminate()
        again.wait(20)
