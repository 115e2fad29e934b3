"""Who may ask a studio: pages of other origins, forged requests, guessed tokens and cookies are kept out.

`python -m benchmarks.reliability --only studio` prints the rows.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from exmesh_graph.studio.serving import secret_of
from exmesh_graph.studio.web.app import application
from exmesh_graph.studio.workspace import Workspace
from tests.studio.conftest import HOST, TOKEN

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
