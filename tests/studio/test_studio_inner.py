"""Steering inside sub-graphs and single rounds: what is offered there, what comes of it, what is saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.workspace import Workspace
from tests.studio.conftest import HOST, opened

PART = """\
inputs: {start: {type: Number}}
params: {by: 2}
nodes:
  first: {type: toy.step, state: "@inputs.start", amount: "${by}"}
  spare: {type: toy.step, state: "@first.state"}
  loop:
    repeat: 2
    carry: {state: "@first.state"}
    nodes: {grow: {type: toy.step, state: "@carry.state"}}
    next: {state: "@grow.state"}
outputs: {end: "@loop.state"}
"""
WHOLE = """\
name: whole
nodes:
  one: {type: toy.const, value: 1}
  p: {graph: part.yaml, start: "@one.number"}
  q: {graph: part.yaml, start: "@one.number"}
  end: {type: toy.add, a: "@p.end", b: "@q.end"}
outputs: {end: "@end.number"}
run: all
"""


@pytest.fixture
def whole(folder: Path) -> Any:
    (folder / "graphs" / "part.yaml").write_text(PART)
    (folder / "graphs" / "whole.yaml").write_text(WHOLE)
    workspace = Workspace(folder / "graphs" / "whole.yaml", store=folder / ".exmesh", runs=folder / "runs")
    with opened(workspace) as browser:
        yield browser
    workspace.close()


def edited(client: TestClient, *ops: Any) -> dict[str, Any]:
    headers = {"X-Exmesh": "1", "Origin": f"http://{HOST}"}
    answer = client.post("/api/edit", json={"ops": list(ops)}, headers=headers)
    assert answer.status_code == 200, answer.text
    told: dict[str, Any] = answer.json()
    assert not told["problems"], told["problems"]
    return told


def nodes(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {node["id"]: node for node in document["nodes"]}


def wires(document: dict[str, Any]) -> set[tuple[str, str]]:
    return {(".".join(w["from"][:2]), ".".join(w["to"][:2])) for w in document["wires"]}


def test_bypass_swap_add_and_remove_in_one_use_of_a_sub_graph(whole: TestClient) -> None:
    told = nodes(edited(whole, {"bypass": "p.first"}))
    assert told["p.first"]["bypassed"]
    assert told["p.first"]["names"] == []
    assert not told["q.first"].get("bypassed")
    assert not nodes(edited(whole, {"restore": "p.first"}))["p.first"].get("bypassed")
    rows = whole.get("/api/swaps", params={"node": "p.first"}).json()["types"]
    assert "toy.leap" in [row["type"] for row in rows if row["ok"]]
    told = nodes(edited(whole, {"replace": "p.first", "type": "toy.leap"}))
    assert (told["p.first"]["type"], told["q.first"]["type"]) == ("toy.leap", "toy.step")
    assert told["p"]["graph"] == "part.yaml (changed)"
    told = nodes(edited(whole, {"add": {"name": "q.more", "type": "toy.step", "state": "@first.state"}}))
    assert told["q.more"]["parent"] == "q"
    assert "p.more" not in told
    told = nodes(edited(whole, {"remove": "q.spare", "force": True}))
    assert "q.spare" not in told
    assert "p.spare" in told
    refused = whole.get("/api/text").json()
    assert "inside the sub-graph" in refused["why_not"]["what"]


def test_one_round_is_bypassed_and_taken_back(whole: TestClient) -> None:
    told = nodes(edited(whole, {"bypass": "p.loop[2].grow"}))["p.loop.grow"]
    assert told["names"] == ["p.loop[1].grow"]
    (layer,) = told["layers"]
    assert (layer["when"], layer["round"], layer["set"]) == ("at", 2, {"bypass": {"state": "state"}})
    assert not told.get("bypassed")
    assert nodes(edited(whole, {"restore": "p.loop[2].grow"}))["p.loop.grow"]["names"] == [
        "p.loop[1].grow", "p.loop[2].grow"
    ]  # fmt: skip
    headers = {"X-Exmesh": "1", "Origin": f"http://{HOST}"}
    answer = whole.post("/api/edit", json={"ops": [{"restore": "p.loop[2].grow"}]}, headers=headers)
    assert answer.status_code == 422
    assert "no edit bypassed" in answer.text


def test_ends_inside_a_sub_graph_are_those_of_its_file(whole: TestClient) -> None:
    told = whole.get("/api/ends", params={"node": "p.loop.grow", "port": "state"}).json()
    assert told["target"] == "p.loop.grow.state"
    fits = {(end["node"], end["side"]): end["link"] for end in told["ends"] if end["ok"]}
    assert fits["p", "inputs"] == "@inputs.start"
    assert fits["p.first", ""] == "@first.state"
    assert not any(node.startswith(("q", "one")) for node, _ in fits)
    assert ("p.loop.grow", "") not in fits
    told = edited(whole, {"connect": "p.loop.grow.state", "to": "@first.state"})
    assert ("p.first.state", "p.loop.grow.state") in wires(told)
    from_input = whole.get("/api/ends", params={"node": "p", "port": "start", "side": "inputs", "output": 1}).json()
    ok = {end["target"]: end["link"] for end in from_input["ends"] if end["ok"]}
    assert ok["p.spare.state"] == "@inputs.start"
    assert "q.spare.state" not in ok
    told = edited(whole, {"connect": "p.spare.state", "to": ok["p.spare.state"]})
    assert ("p.start", "p.spare.state") in wires(told)
