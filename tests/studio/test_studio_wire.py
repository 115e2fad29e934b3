"""Attacks on how HTTP is read and on how much a server bears, on a real socket of this machine."""

from __future__ import annotations

import contextlib
import socket
import time
from pathlib import Path

import pytest

from exmesh_graph.studio import serving
from tests.studio.test_studio_sockets import browser, head, port, said

__all__ = ["port"]  # the fixture


def cookie_of(port: int) -> str:
    with browser(port) as client:
        return "; ".join(f"{name}={value}" for name, value in client.cookies.items())


@pytest.mark.reliability(
    "studio: requests smuggled in others (two lengths, chunks beside a length, folded and bare lines)",
    "at most one answer, the connection closed",
)
def test_smuggled_requests(port: int) -> None:
    inner = f"GET /api/session HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nCookie: {cookie_of(port)}\r\n\r\n"
    start = f"POST /api/edit HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
    for lines in (
        "Content-Length: 0\r\nContent-Length: 5\r\n",
        "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n",
        "Transfer-Encoding: chunked\r\nTransfer-Encoding: identity\r\n",
        "Transfer-Encoding: xchunked\r\n",
        "Transfer-Encoding : chunked\r\n",
        "Transfer-Encoding:\x0bchunked\r\n",
        "Content-Length: +5\r\n",
        "Content-Length: 0x5\r\n",
        "Content-Length: 5, 5\r\n",
        "X: y\r\n Content-Length: 5\r\n",
        "X: y\nContent-Length: 5\n",
    ):
        for body in ("0\r\n\r\n", "5\r\n", ""):
            answer = said(port, (start + lines + "\r\n" + body + inner).encode("latin-1"), wait=3)
            assert answer.count(b"HTTP/1.1 ") <= 1, (lines, answer)
            assert b'"server"' not in answer


@pytest.mark.reliability(
    "studio: used as a proxy (absolute addresses, CONNECT), upgraded (WebSocket, HTTP/2)",
    "400 to 405, never 101 nor 200",
)
def test_proxies_and_upgrades(port: int) -> None:
    home, cookie = f"127.0.0.1:{port}", f"Cookie: {cookie_of(port)}"
    for first in ("GET http://evil.example/ HTTP/1.1", "CONNECT evil.example:443 HTTP/1.1", 
                  "GET //evil.example HTTP/1.1",                  "GET @evil.example/api/session HTTP/1.1",
                  "OPTIONS * HTTP/1.1"):  # fmt: skip
        answer = said(port, f"{first}\r\nHost: {home}\r\n{cookie}\r\nConnection: close\r\n\r\n".encode())
        assert answer[9:12] in (b"400", b"403", b"404", b"405"), (first, answer)
    for kind in ("websocket", "h2c", "TLS/1.2"):
        more = ("Connection: Upgrade, HTTP2-Settings", f"Upgrade: {kind}", "HTTP2-Settings: AAMAAABk", "Origin: http://evil",
                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", cookie)  # fmt: skip
        assert said(port, head(port, *more), wait=2)[9:12] in (b"400", b"403")
    assert b"101 Switching" not in said(port, b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")


@pytest.mark.reliability(
    "studio: paths in other codings (twice encoded, overlong UTF-8, full-width dots, backslashes, NUL)", "404, 400"
)
def test_encoded_paths(port: int) -> None:
    cookie = f"Cookie: {cookie_of(port)}"
    for path in ("%252e%252e/%252e%252e/serving.py", "%c0%ae%c0%ae/serving.py", "%ef%bc%8e%ef%bc%8e/serving.py",
                 "..%5cserving.py", "..;/serving.py", "./.././serving.py", "%2e%2e%2fserving.py", "index.html%00",
                 "%uff0e%uff0e/serving.py", "..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
                 "/////etc/passwd", "%ff%fe"):  # fmt: skip
        for home in ("static", "assets"):
            lines = f"GET /{home}/{path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{cookie}\r\nConnection: close\r\n\r\n"
            answer = said(port, lines.encode())
            assert answer[9:12] in (b"404", b"400"), (path, answer[:200])


@pytest.mark.reliability("studio: thousands of ranges of one file, ranges of no sense", "206, 400 or 416, at once")
def test_ranges(port: int) -> None:
    (script, *_) = (Path(serving.__file__).parent / "static" / "assets").glob("index-*.js")
    with browser(port) as client:
        for text in ("bytes=" + ",".join(f"{k}-{k + 1}" for k in range(0, 3000, 2)), "bytes=0-,0-,0-,0-" + ",0-" * 1000,
                     "bytes=9-1", "bytes=-0", "bytes=99999999999999999999-", "bytes=a-b", "lines=1-2",
                     "bytes=" + "-" * 5000):  # fmt: skip
            began = time.monotonic()
            answer = client.get(f"/static/assets/{script.name}", headers={"range": text})
            assert answer.status_code in (200, 206, 400, 416)
            assert len(answer.content) < 3 * script.stat().st_size
            assert time.monotonic() - began < 5
        assert client.get("/api/session", headers={"range": "bytes=0-3"}).status_code == 200


@pytest.mark.reliability(
    "studio: hundreds of connections that say nothing", "others wait for seconds at most; all are let go"
)
def test_idle_connections(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(400)]
        began = time.monotonic()
        while time.monotonic() - began < 20:
            with contextlib.suppress(AssertionError, OSError), browser(port) as client:
                assert client.get("/api/session").status_code == 200
                break
            time.sleep(0.1)
        else:
            raise AssertionError("the server did not answer beside idle connections")
        for link in idle:
            link.settimeout(10)
            with contextlib.suppress(ConnectionError):
                assert link.recv(1) == b""  # closed by the server


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: large answers that are never read, hundreds of them", "the memory stays; others are answered"
)
def test_answers_that_are_not_read(port: int) -> None:
    ask = head(port, f"Cookie: {cookie_of(port)}").replace(b"/api/session", b"/api/catalog")
    with contextlib.ExitStack() as stack:
        for _ in range(60):
            link = stack.enter_context(socket.socket())
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            link.connect(("127.0.0.1", port))
            link.sendall(ask * 4)
        began = time.monotonic()
        with browser(port) as client:
            assert client.get("/api/session").status_code == 200
        assert time.monotonic() - began < 15


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: searches and names made to be slow (patterns, endless words)", "an answer within seconds"
)
def test_slow_searches(port: int) -> None:
    with browser(port) as client:
        for text in ("a " * 5000, "(a+)+$" * 30, "." * 10_000, "one" + ".a" * 3000, "[1]" * 3000, "\u0130" * 5000):
            began = time.monotonic()
            for path, name in (
                ("/api/catalog/search", "q"),
                ("/api/why", "node"),
                ("/api/plan", "nodes"),
                ("/api/ends", "node"),
            ):
                status = client.get(path, params={name: text[:12_000]}).status_code
                assert status in (200, 400, 404, 422, 431), (path, text[:20], status)
            client.post("/api/edit", json={"ops": [{"set": text, "to": 1}, {"rename": "one", "to": text}]})
            assert time.monotonic() - began < 5, text[:20]
