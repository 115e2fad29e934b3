"""What pages of other origins, forged requests, odd paths and odd data can do to a studio: nothing.

Each test ends with the server answering as before. `python -m benchmarks.reliability --only studio` prints the rows.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.serving import secret_of
from exmesh_graph.studio.web.app import application
from exmesh_graph.studio.workspace import Workspace
from tests.studio.conftest import HOST, TOKEN, made_in, opened

EVERY = (
    "/",
    "/api/session",
    "/api/document",
    "/api/catalog",
    "/api/runs",
    "/api/events",
    "/api/graphs",
    "/api/text",
    "/api/artifact?digest=00000000",
    "/static/index.html",
    "/assets/three.module.min.js",
    "/nothing",
)
ORIGINS = (
    "https://evil.example",
    "null",
    f"https://{HOST}",
    "http://127.0.0.1:8001",
    "http://localhost",
    "file://",
    f"http://{HOST}.evil.example",
)
HOSTS = (
    "evil.example",
    "evil.example:8000",
    "127.0.0.1",
    "127.0.0.1:8001",
    "localhost:8000.evil.example",
    "0.0.0.0:8000",
    "127.0.0.1:8000, evil.example",
    "[::1]:8000",
)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        yield made_in(tmp_path_factory.mktemp("attacked"), patch)


@pytest.fixture(scope="module")
def workspace(home: Path) -> Iterator[Workspace]:
    made = Workspace(home / "graphs" / "small.yaml", store=home / ".exmesh", runs=home / "runs")
    yield made
    made.close()


@pytest.fixture(scope="module")
def open_client(workspace: Workspace) -> Iterator[TestClient]:
    with opened(workspace) as browser:
        yield browser


@pytest.fixture
def client(open_client: TestClient) -> Iterator[TestClient]:
    """A browser with the cookie; after the attack the server answers it as before, and the graph is as it was."""
    headers = dict(open_client.headers)
    yield open_client
    open_client.headers.clear()
    open_client.headers.update(headers)
    told = open_client.post("/api/open", json={"file": "small.yaml", "discard": True})
    assert told.status_code == 200
    assert (told.json()["name"], told.json()["ops"]) == ("small", [])


@pytest.fixture
def folder(home: Path) -> Iterator[Path]:
    """The working folder, which is swept afterwards."""
    yield home
    for path in home.rglob("*"):
        if (path.is_symlink() or not path.is_dir()) and path.name != "small.yaml" and ".exmesh" not in path.parts:
            path.unlink()
    shutil.rmtree(home / "runs", ignore_errors=True)


@pytest.fixture
def stranger(open_client: TestClient) -> TestClient:
    """A client of the same server that has no cookie."""
    return TestClient(open_client.app, base_url=f"http://{HOST}", follow_redirects=False)


def edit(client: TestClient, *ops: Any) -> Any:
    return client.post("/api/edit", json={"ops": list(ops)})


# --- who may ask


@pytest.mark.reliability("studio: any address without the cookie", "401, nothing told")
@pytest.mark.parametrize("path", EVERY)
def test_without_a_cookie_nothing_is_told(stranger: TestClient, path: str) -> None:
    answer = stranger.get(path)
    assert answer.status_code == 401
    assert "small" not in answer.text


@pytest.mark.reliability(
    "studio: a wrong token, two tokens, a token elsewhere than in /, that of an earlier server", "401"
)
@pytest.mark.parametrize(
    "query",
    [
        "token=",
        "token=wrong",
        f"token={TOKEN}&token=x",
        f"token={TOKEN}x",
        "token=%00",
        f"Token={TOKEN}",
        "token=" + "x" * 5000,
    ],
)
def test_wrong_tokens(stranger: TestClient, query: str) -> None:
    answer = stranger.get(f"/?{query}")
    assert answer.status_code == 401
    assert "set-cookie" not in answer.headers


@pytest.mark.reliability(
    "studio: a token that is replayed against another path, by POST, or after a restart", "401, 403"
)
def test_a_token_is_good_in_one_place_only(stranger: TestClient, workspace: Workspace) -> None:
    assert stranger.get("/api/session", params={"token": TOKEN}).status_code == 401
    assert stranger.post(f"/?token={TOKEN}", data={"token": TOKEN}).status_code == 403
    restarted = TestClient(application(workspace, {HOST}, "another"), base_url=f"http://{HOST}", follow_redirects=False)
    assert restarted.get("/", params={"token": TOKEN}).status_code == 401


@pytest.mark.reliability("studio: cookies that are guessed, the token as cookie, the cookie of another studio", "401")
@pytest.mark.parametrize(
    "cookie",
    [
        "exmesh_studio=",
        f"exmesh_studio={TOKEN}",
        "exmesh_studio=\u00e9",
        "exmesh_studio_9=x",
        "exmesh_studio=a; exmesh_studio=b",
        ";;;=;",
    ],
)
def test_wrong_cookies(stranger: TestClient, cookie: str) -> None:
    assert stranger.get("/api/session", headers={b"cookie": cookie.encode("latin-1")}).status_code == 401


def test_a_server_that_was_started_again_knows_its_browsers(workspace: Workspace, home: Path) -> None:
    secret = secret_of(home / "studio")
    assert secret == secret_of(home / "studio")
    assert (home / "studio" / "secret").stat().st_mode & 0o077 == 0
    (home / "studio" / "secret").chmod(0o644)  # anybody may have read it
    assert secret_of(home / "studio") != secret
    browser = TestClient(application(workspace, {HOST}, TOKEN, secret=secret), base_url=f"http://{HOST}")
    assert browser.get("/", params={"token": TOKEN}).status_code in (200, 404)
    for other, status in ((secret, 200), (b"x" * 32, 401)):
        again = TestClient(application(workspace, {HOST}, "new", secret=other), base_url=f"http://{HOST}")
        assert again.get("/api/session", cookies=dict(browser.cookies)).status_code == status


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(stranger: TestClient) -> None:
    answer = stranger.get("/", params={"token": TOKEN})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/"
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= {
        part.strip() for part in answer.headers["set-cookie"].split(";")
    }
    assert TOKEN not in answer.headers["set-cookie"]


@pytest.mark.reliability("studio: a page of another origin asks with the cookie", "403, nothing changed")
@pytest.mark.parametrize("origin", ORIGINS)
def test_foreign_origins(client: TestClient, origin: str) -> None:
    assert client.get("/api/document", headers={"origin": origin}).status_code == 403
    assert (
        client.post("/api/edit", json={"ops": [{"set": "n", "to": 1}]}, headers={"origin": origin}).status_code == 403
    )
    assert client.get("/api/document").json()["ops"] == []


@pytest.mark.reliability("studio: DNS rebinding, the server under another name", "403")
@pytest.mark.parametrize("host", HOSTS)
def test_rebinding(client: TestClient, host: str) -> None:
    assert client.get("/api/document", headers={"host": host}).status_code == 403
    assert client.get(f"/?token={TOKEN}", headers={"host": host}).status_code == 403


@pytest.mark.reliability("studio: a form, an image or a frame of another page (Sec-Fetch-Site, plain bodies)", "403")
def test_forged_requests(client: TestClient) -> None:
    for site in ("cross-site", "same-site"):
        assert client.get("/api/document", headers={"sec-fetch-site": site}).status_code == 403
    body = json.dumps({"ops": [{"set": "n", "to": 1}]})
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""):
        assert client.post("/api/edit", content=body, headers={"content-type": kind}).status_code == 403
    plain = {key: value for key, value in client.headers.items() if key != "x-exmesh"}
    client.headers.clear()
    client.headers.update(plain)
    assert client.post("/api/edit", json={"ops": [{"set": "n", "to": 1}]}).status_code == 403
    assert client.get("/api/document").json()["ops"] == []


@pytest.mark.reliability(
    "studio: other methods, preflights, GET of what changes things", "405, no CORS header, no change"
)
@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "BREW"])
def test_other_methods(client: TestClient, method: str) -> None:
    answer = client.request(method, "/api/document", headers={"access-control-request-method": "POST"})
    assert answer.status_code == 405
    assert not [name for name in answer.headers if name.startswith("access-control")]
    for path in ("/api/edit", "/api/save", "/api/undo", "/api/open", "/api/runs/stop", "/api/sweep"):
        assert client.get(path).status_code in (404, 405)


def test_answers_may_not_be_framed_sniffed_or_kept(client: TestClient) -> None:
    for path in ("/", "/api/document", "/nothing"):
        headers = client.get(path).headers
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "unsafe-inline" not in headers["content-security-policy"].partition("script-src")[2].partition(";")[0]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
    assert client.get("/api/document").headers["cache-control"] == "no-store"


# --- paths

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


@pytest.mark.reliability("studio: path tricks in the page's files", "404")
@pytest.mark.parametrize("path", OUT)
def test_paths_out_of_the_pages_files(client: TestClient, path: str) -> None:
    for home in ("/static/", "/assets/"):
        answer = client.get(home + path)
        assert answer.status_code == 404
        assert "root:" not in answer.text


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


# --- what runs


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


# --- data


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
