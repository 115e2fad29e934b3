"""Messages to a studio that are broken, giant or odd."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.workspace import Workspace


def edit(client: TestClient, *ops: Any) -> Any:
    return client.post("/api/edit", json={"ops": list(ops)})


@pytest.mark.thorough
@pytest.mark.reliability("studio: bodies that are no JSON, no object, nest or count too deep", "400")
@pytest.mark.parametrize(
    "body",
    [
        b"{",
        b"[]",
        b"1",
        b'"x"',
        b"null",
        b"\xff\xfe",
        b'{"ops": NaN}',
        b"[" * 100_000,
        b'{"ops": ' + b"[" * 50_000 + b"]" * 50_000 + b"}",
        b"{'ops': 1}",
        b"\0",
    ],
)
def test_broken_json(client: TestClient, body: bytes) -> None:
    for path in ("/api/edit", "/api/runs", "/api/ablation"):
        answer = client.post(path, content=body, headers={"content-type": "application/json"})
        assert answer.status_code == 400, answer.text
        assert answer.json()["error"]["code"] == "bad-request"


@pytest.mark.reliability("studio: a message of megabytes", "413")
def test_giant_messages(client: TestClient) -> None:
    answer = client.post("/api/edit", json={"ops": [{"set": "one.label", "to": "x" * (2 << 20)}]})
    assert answer.status_code == 413

    def parts() -> Iterator[bytes]:
        for _ in range(64):
            yield b" " * 65536

    chunked = client.post("/api/edit", content=parts(), headers={"content-type": "application/json"})
    assert chunked.status_code == 413


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: edits with other types, control characters, huge numbers and texts, unknown words",
    "400, 422, or a fault of the graph",
)
@pytest.mark.parametrize(
    "op",
    [
        {"set": 3, "to": 1},
        {"set": None, "to": 1},
        {"set": "n"},
        {"set": {"n": {"a": {}}}},
        {"set": "n", "to": 10**40},
        {"set": "one.label", "to": "a\x1b[2J"},
        {"set": "one.label", "to": "\ud800"},
        {"set": "one.label", "to": "x" * 100_000},
        {"set": "a" * 100_000, "to": 1},
        {"connect": ["x"], "to": {}},
        {"connect": "sum.b", "to": "@" + "a." * 5000},
        {"add": []},
        {"add": {"name": "<script>", "type": "toy.const"}},
        {"add": {"name": "x", "type": {}}},
        {"remove": {}},
        {"rename": "one", "to": "../x"},
        {"rename": "one", "to": 3},
        {"bypass": ["x"]},
        {"replace": "one", "type": ["x"]},
        {"insert": 1, "on": 2},
        {"output": "../x", "to": "@one.number"},
        {"unset": {}},
        {"exec": "x"},
        {},
        [],
        "x",
        1,
        None,
        {"set": "n", "to": 1, "connect": "x"},
        {"__class__": 1},
        {"disconnect": None},
        {"set": "n", "to": {"a": [[[[]]]]}},
    ],
)
def test_odd_edits(client: TestClient, op: Any) -> None:
    answer = client.post(
        "/api/edit", content=json.dumps({"ops": [op]}).encode(), headers={"content-type": "application/json"}
    )
    assert answer.status_code in (200, 400, 422), answer.text
    if answer.status_code == 200:
        assert answer.json()["problems"]
        assert client.post("/api/undo", json={}).status_code == 200
    assert client.get("/api/document").json()["problems"] == []


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: odd bodies and queries to every address", "an answer that says what is wrong, never 500"
)
def test_odd_values_everywhere(client: TestClient) -> None:
    values: list[Any] = [None, 1, "x", [], {}, ["x"], {"a": 1}, "../..", True, -1, 1e308]
    names = (
        "ops",
        "file",
        "as",
        "name",
        "nodes",
        "force",
        "start",
        "id",
        "variants",
        "repeats",
        "workers",
        "set",
        "label",
    )
    for path in (
        "/api/edit",
        "/api/try",
        "/api/open",
        "/api/save",
        "/api/ablation",
        "/api/sweep",
        "/api/runs/stop",
        "/api/runs/resume",
        "/api/runs/label",
    ):
        for value in values:
            answer = client.post(path, json=dict.fromkeys(names, value))
            assert answer.status_code in (400, 404, 409, 422) or "refused" in answer.text, (path, value, answer.text)
    for path in (
        "/api/ends",
        "/api/swaps",
        "/api/why",
        "/api/plan",
        "/api/catalog/search",
        "/api/artifact",
        "/api/artifact/picture",
        "/api/artifact/model",
        "/api/artifact/file",
        "/api/light",
        "/api/compare",
        "/api/runs",
    ):
        for text in ("", "x", "-1", "9" * 400, "\u202e", "a=b&c", "\0"):
            query = dict.fromkeys(
                ("node", "nodes", "port", "side", "q", "limit", "last", "digest", "name", "a", "b", "size"), text
            )
            assert client.get(path, params=query).status_code in (200, 400, 404, 422), (path, text)


@pytest.mark.reliability(
    "studio: scripts in names, texts, labels and files of artifacts", "data: JSON, no sniffing, no page of ours"
)
def test_scripts_in_texts(client: TestClient) -> None:
    script = "<script>alert(1)</script>"
    told = edit(client, {"set": "one.label", "to": script})
    assert told.headers["content-type"] == "application/json"
    assert told.headers["x-content-type-options"] == "nosniff"
    missing = client.get(f"/api/{script}")
    assert missing.status_code == 404
    assert missing.headers["content-type"] == "application/json"
    split = client.get("/api/light", params={"name": "studio", "digest": "x\r\nset-cookie: a=b"})
    assert "set-cookie" not in split.headers
    client.post("/api/undo", json={})


@pytest.mark.reliability("studio: hundreds of edits at once; more runs than allowed", "400; 429")
def test_floods(client: TestClient, workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    assert edit(client, *[{"set": "n", "to": 1}] * 201).status_code == 400
    monkeypatch.setattr(workspace.jobs, "alive", lambda: {key: {} for key in "abcd"})
    answer = client.post("/api/runs", json={})
    assert answer.status_code == 429
    assert answer.json()["error"]["fix"]
