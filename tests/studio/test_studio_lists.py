"""Lists on wires, `each` and gathered ones as the page shows and offers them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.workspace import Workspace
from tests.studio.conftest import HOST, opened

LISTS = """\
name: lists
nodes:
  n: {type: toy.const, value: 4}
  parts: {type: toy.cut, number: "@n.number", parts: 3}
  moved: {type: toy.shift, each: number, number: "@parts.parts", by: 1}
  all: {type: toy.gather, numbers: ["@n.number", "@moved.number"]}
  two: {type: toy.gather, numbers: "@parts.parts"}
  end: {type: toy.add, a: "@all.number", b: "@two.number"}
outputs: {end: "@end.number"}
"""


@pytest.fixture
def lists(folder: Path) -> Iterator[TestClient]:
    (folder / "graphs" / "lists.yaml").write_text(LISTS)
    workspace = Workspace(folder / "graphs" / "lists.yaml", store=folder / ".exmesh", runs=folder / "runs")
    with opened(workspace) as browser:
        yield browser
    workspace.close()


def test_wires_of_lists_are_shown(lists: TestClient) -> None:
    told = lists.get("/api/document").json()
    assert told["problems"] == []
    ends = [(wire["from"][0], wire["to"][0], wire["to"][1]) for wire in told["wires"]]
    assert [end for end in ends if end[1] == "all"] == [("n", "all", "numbers"), ("moved", "all", "numbers")]
    assert {node["id"]: node.get("wired") for node in told["nodes"]}["all"] == ["numbers"]


def test_what_is_one_and_what_is_a_list(lists: TestClient) -> None:
    def offered(node: str, port: str) -> dict[tuple[str, str], Any]:
        told = lists.get("/api/ends", params={"node": node, "port": port, "output": 1}).json()
        return {(one["node"], one["port"]): one for one in told["ends"]}

    listed = offered("parts", "parts")
    assert "is a list, and end.a takes one" in listed["end", "a"]["why"]
    assert listed["all", "numbers"]["ok"]
    assert listed["moved", "number"]["ok"]
    assert "is a list, and end.a takes one" in offered("moved", "number")["end", "a"]["why"]
    single = offered("n", "number")
    assert single["end", "a"]["ok"]
    assert "moved.number takes a list (`each`), and n.number is one" in single["moved", "number"]["why"]


def test_edits_of_lists(lists: TestClient) -> None:
    headers = {"X-Exmesh": "1", "Origin": f"http://{HOST}"}

    def edit(*ops: Any) -> Any:
        return lists.post("/api/edit", json={"ops": list(ops)}, headers=headers)

    refused = edit({"rename": "n", "to": "m"})
    assert refused.status_code == 422
    assert "a list that links to it" in refused.text
    done = edit({"connect": "all.numbers", "to": "@parts.parts"}).json()
    assert done["problems"] == []
    assert [wire["from"][0] for wire in done["wires"] if wire["to"][0] == "all"] == ["parts"]
    assert edit({"disconnect": "all.numbers"}).status_code == 422  # which needs one


def test_a_run_of_lists(folder: Path) -> None:
    import exmesh_graph as ex

    (folder / "graphs" / "lists.yaml").write_text(LISTS)
    places = {"store": folder / ".exmesh", "runs": folder / "runs"}
    run = ex.run(folder / "graphs" / "lists.yaml", workers=0, progress=False, report=False, **places)
    workspace = Workspace(folder / "graphs" / "lists.yaml", **places)
    with opened(workspace) as browser:
        assert browser.get("/api/plan").json()["plan"]["nodes"]["moved"]["state"] == "hit"
        graph = browser.get(f"/api/runs/{run.id}/graph").json()
        assert {"n", "parts", "moved", "all", "two", "end"} <= {node["id"] for node in graph["nodes"]}
        ends = {(wire["from"][0], wire["to"][0]) for wire in graph["wires"]}
        assert {("n", "all"), ("moved", "all"), ("parts", "moved")} <= ends
        details = browser.get(f"/api/runs/{run.id}").json()["nodes_detail"]
        assert {row["state"] for row in details} == {"done"}
    workspace.close()
