"""What the browsers of others could be made to do with a studio's address, its cookie and its answers."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from tests.studio.conftest import TOKEN

EDIT = {"ops": [{"set": "n", "to": 1}]}
CHANGES = ("/api/edit", "/api/save", "/api/undo", "/api/open", "/api/runs", "/api/runs/stop", "/api/sweep")


@pytest.mark.reliability(
    "studio: a cookie that somebody else set before the login (fixation)", "401; the login gives another"
)
def test_fixed_cookies(stranger: TestClient) -> None:
    planted = "planted." + "0" * 64
    stranger.cookies.set("exmesh_studio", planted)
    answer = stranger.get("/", params={"token": TOKEN})
    given = answer.headers["set-cookie"].partition(";")[0].partition("=")[2]
    assert given.partition(".")[0] != "planted"
    stranger.cookies.clear()
    for cookie in (planted, "planted." + given.partition(".")[2]):  # the seal is of its own name alone
        assert stranger.get("/api/session", headers={"cookie": f"exmesh_studio={cookie}"}).status_code == 401


@pytest.mark.reliability(
    "studio: the token in histories, Referer and caches", "the address goes on without it; no-referrer, no-store"
)
def test_the_token_is_not_passed_on(stranger: TestClient, client: TestClient) -> None:
    answer = stranger.get("/", params={"token": TOKEN})
    assert answer.headers["location"] == "/"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["cache-control"] == "no-store"
    for path in ("/", "/api/session", "/api/document", "/static/index.html"):
        told = client.get(path)
        assert TOKEN not in told.text
        assert TOKEN not in str(told.headers)


@pytest.mark.reliability(
    "studio: what a cache kept is asked for by a stranger (If-None-Match, If-Range)", "401; answers are private"
)
def test_caches(stranger: TestClient, client: TestClient) -> None:
    for path in ("/static/index.html", "/api/lights", "/api/artifact?digest=00000000"):
        known = client.get(path)
        assert known.headers["cache-control"] in ("no-store", "no-cache") or "private" in known.headers["cache-control"]
        tag = known.headers.get("etag", "*")
        for name in ("if-none-match", "if-match", "if-range"):
            assert stranger.get(path, headers={name: tag}).status_code == 401


@pytest.mark.reliability(
    "studio: the page or an answer in a frame, as a script or a picture of another page",
    "403; no answer may be framed, and none is of a kind that it was not sent as",
)
def test_frames_and_sniffing(client: TestClient) -> None:
    for path in ("/", "/api/document", "/api/catalog", "/static/index.html", "/nothing"):
        for kind in ("iframe", "script", "image", "style", "object"):
            asked = client.get(path, headers={"sec-fetch-dest": kind, "sec-fetch-site": "cross-site"})
            assert asked.status_code == 403
        headers = client.get(path).headers
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "object-src" not in headers["content-security-policy"]  # default-src 'none' holds for it
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["cross-origin-opener-policy"] == "same-origin"


@pytest.mark.reliability(
    "studio: a GET that says it is a POST (X-HTTP-Method-Override, _method)", "404, 405; nothing changed"
)
def test_method_override(client: TestClient) -> None:
    names = ("x-http-method-override", "x-http-method", "x-method-override")
    for path in CHANGES:
        answer = client.request(
            "GET", path, params={"_method": "POST"}, headers=dict.fromkeys(names, "POST"), content=json.dumps(EDIT)
        )
        assert answer.status_code in (404, 405) or path == "/api/runs"
    assert client.get("/api/runs").json()["runs"] == []
    assert client.get("/api/document").json()["ops"] == []


@pytest.mark.reliability(
    "studio: bodies without a content type, of one that resembles JSON, in UTF-7, or packed (gzip)", "400, 403"
)
def test_content_types(client: TestClient) -> None:
    body = json.dumps(EDIT).encode()
    for kind in (
        "application/json-patch+json",
        "text/json",
        "application/jsonp",
        "application/json, text/plain",
        "*/*",
    ):
        assert client.post("/api/edit", content=body, headers={"content-type": kind}).status_code == 403
    assert client.post("/api/edit", content=body).status_code == 403
    packed = {"content-type": "application/json", "content-encoding": "gzip"}
    assert client.post("/api/edit", content=gzip.compress(b" " * (1 << 26)), headers=packed).status_code == 400
    utf7 = {"content-type": "application/json; charset=utf-7"}
    assert client.post("/api/edit", content=b"+AHsAIgBvAHAAcwAi-", headers=utf7).status_code == 400
    assert client.get("/api/document").json()["ops"] == []


@pytest.mark.reliability(
    "studio: a graph whose names are words of JavaScript (__proto__, constructor)", "names like any other"
)
def test_words_of_javascript(client: TestClient, folder: Path) -> None:
    (folder / "graphs" / "words.yaml").write_text(
        "nodes:\n  constructor: {type: toy.const}\n  __proto__: {type: toy.add, a: '@constructor.number'}\n"
        "  toString: {type: constructor}\nparams: {__proto__: {type: int, default: 1}}\n"
    )
    told = client.post("/api/open", json={"file": "words.yaml"}).json()
    assert [node["id"] for node in told["nodes"]] == ["constructor", "__proto__", "toString"]
    assert list(told["types"]) == ["toy.const", "toy.add"]
    body = b'{"__proto__": {"ops": [{"set": "n", "to": 1}]}, "constructor": {"prototype": {"discard": true}}}'
    answer = client.post("/api/edit", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 400


@pytest.mark.reliability(
    "studio: the key of the cookies is read or replaced by another user", "one that others may read is made anew"
)
def test_the_key_of_the_cookies(tmp_path: Path) -> None:
    from exmesh_graph.studio.serving import secret_of

    secret = secret_of(tmp_path)
    (tmp_path / "secret").unlink()
    (tmp_path / "other").write_bytes(b"k" * 32)
    (tmp_path / "secret").symlink_to(tmp_path / "other")  # one that somebody else knows
    made = secret_of(tmp_path)
    assert made not in (secret, b"k" * 32)
    assert (tmp_path / "other").read_bytes() == b"k" * 32
    assert not (tmp_path / "secret").is_symlink()
