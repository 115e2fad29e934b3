"""The open graph: what the page is told of it, and what edits make of it."""

from __future__ import annotations

from typing import Any

from starlette.testclient import TestClient

from exmesh_graph.studio.web.app import STATIC
from exmesh_graph.studio.workspace import Workspace


def post(client: TestClient, path: str, **body: Any) -> dict[str, Any]:
    answer = client.post(path, json=body)
    assert answer.status_code == 200, answer.text
    return answer.json()  # type: ignore[no-any-return]


def edited(client: TestClient, *ops: dict[str, Any]) -> dict[str, Any]:
    return post(client, "/api/edit", ops=list(ops))


def node(document: dict[str, Any], name: str) -> dict[str, Any]:
    return next(one for one in document["nodes"] if one["id"] == name)


def test_the_document_folds_rounds_and_tells_ends(client: TestClient) -> None:
    told = client.get("/api/document").json()
    assert [n["id"] for n in told["nodes"]] == ["one", "rounds", "rounds.step", "rounds.leap", "sum", "files"]
    assert node(told, "rounds.step")["names"] == [f"rounds[{i}].step" for i in (1, 2, 3)]
    assert "names" not in node(told, "one")  # what is as usual is left out
    assert node(told, "rounds")["kind"] == "block"
    assert node(told, "rounds")["repeat"] == 3
    assert node(told, "rounds")["outputs"][0]["types"] == ["Number"]
    wires = {(tuple(wire["from"]), tuple(wire["to"])): wire for wire in told["wires"]}
    assert (("rounds", "state", "carry"), ("rounds.step", "state", "")) in wires
    assert wires[("rounds.leap", "state", ""), ("rounds", "state", "next")]["target"] == "rounds.next.state"
    assert told["problems"] == []
    plan = client.get("/api/plan").json()["plan"]  # the document does not wait for it
    assert plan["counts"] == {"hit": 0, "run": 1, "unknown": 8}
    assert node(told, "rounds.step")["given"] == {"amount": {"value": 2}}
    (amount,) = told["types"]["toy.step"]["parameters"]
    assert (amount["name"], amount["default"]) == ("amount", 1.0)  # of each type, once


def test_the_first_answers_are_made_before_a_page_asks(client: TestClient, workspace: Workspace) -> None:
    """What most of a first paint was: reading all nodes, and their code for the plan."""
    known = workspace.planner._known
    assert known is not None
    assert known[0] is workspace.document.judged()
    first, again = workspace.facts(wait=60), workspace.facts(wait=60)
    assert first["plan"]["counts"]["run"] == 1
    assert again["nodes"] is first["nodes"]
    edited(client, {"set": "one.value", "to": 5})
    assert node(workspace.facts(), "one")["given"]["value"]["value"] == 5


def test_the_pages_files_are_compressed_once(client: TestClient) -> None:
    (script,) = (STATIC / "assets").glob("index-*.js")
    for _ in range(2):
        answer = client.get(f"/static/assets/{script.name}")
        assert answer.headers["content-encoding"] == "gzip"
        assert answer.headers["vary"] == "Accept-Encoding"
        assert answer.content == script.read_bytes()
    plain = client.get(f"/static/assets/{script.name}", headers={"accept-encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.content == script.read_bytes()
    assert client.get("/static/assets/nothing.js").status_code == 404


def test_a_page_knows_whether_it_missed_an_event(client: TestClient, workspace: Workspace) -> None:
    """The document is asked for before the stream of events is open; each tells how many events there were."""
    hub = workspace.hub
    told = client.get("/api/document").json()
    assert told["events"] <= hub.number
    edited(client, {"set": "one.value", "to": 5})
    assert hub.number > told["events"]
    assert client.get("/api/document").json()["events"] >= told["events"] + 1


def test_edits_are_checked_undone_and_done_again(client: TestClient) -> None:
    told = edited(client, {"set": "one.value", "to": 5})
    assert told["dirty"]
    assert told["can_undo"]
    assert told["patch"] == "- {set: one.value, to: 5}\n"
    told = edited(client, {"set": "one.value", "to": 5000})
    assert told["problems"][0]["node"] == "one"
    assert "1000" in told["problems"][0]["what"]
    assert len(told["ops"]) == 1  # one value, one patch
    assert post(client, "/api/undo")["problems"] == []
    assert post(client, "/api/undo")["dirty"] is False
    assert post(client, "/api/redo")["ops"] == [{"set": "one.value", "to": 5}]


def test_a_wire_that_does_not_fit_is_a_fault_at_its_end(client: TestClient) -> None:
    told = edited(client, {"connect": "sum.b", "to": "@files.files"})
    faults = {fault["code"]: fault for fault in told["problems"]}
    assert (faults["wrong-type"]["node"], faults["wrong-type"]["port"]) == ("sum", "b")
    assert "cycle" in faults
    assert client.get("/api/plan").json()["plan"] is None


def test_a_refused_edit_changes_nothing(client: TestClient) -> None:
    answer = client.post("/api/edit", json={"ops": [{"remove": "one"}]})
    assert answer.status_code == 422
    assert "links to it" in answer.json()["error"]["what"]
    assert client.get("/api/document").json()["ops"] == []


def test_renaming_keeps_all_wires(client: TestClient) -> None:
    told = edited(client, {"rename": "one", "to": "first"})
    assert told["problems"] == []
    assert {w["from"][0] for w in told["wires"] if w["to"][0] in ("sum", "rounds")} >= {"first"}


def test_two_browsers_see_one_state(client: TestClient) -> None:
    before = client.get("/api/document").json()["revision"]
    edited(client, {"set": "n", "to": 2})
    late = client.post("/api/edit", json={"revision": before, "ops": [{"set": "n", "to": 9}]})
    assert late.status_code == 409
    assert client.get("/api/document").json()["ops"] == [{"set": "n", "to": 2}]
