"""Attacks on the connection itself, against a real server on a real socket of this machine."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator

import httpx
import pytest

from exmesh_graph.studio import hub, serving
from exmesh_graph.studio.web import guard
from exmesh_graph.studio.workspace import Workspace
from tests.studio.conftest import TOKEN


@pytest.fixture
def port(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A server with short patience; its port."""
    monkeypatch.setattr(serving, "_HEAD_SECONDS", 0.6)
    monkeypatch.setattr(guard, "BODY_SECONDS", 0.6)
    uvicorn = pytest.importorskip("uvicorn", reason="the extra `studio` is not installed")
    listener = serving._listener(0)
    number = int(listener.getsockname()[1])
    server = uvicorn.Server(serving.configuration(workspace, number, TOKEN))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield number
    with browser(number) as client:  # it is still there, whatever was done to it
        assert client.get("/api/session").status_code == 200
    server.should_exit = True
    thread.join(20)
    listener.close()


@contextlib.contextmanager
def browser(port: int) -> Iterator[httpx.Client]:
    """A client with the cookie."""
    many = httpx.Limits(max_connections=None)
    with httpx.Client(
        base_url=f"http://127.0.0.1:{port}", headers={"x-exmesh": "1"}, timeout=30, limits=many
    ) as client:
        assert client.get("/", params={"token": TOKEN}).status_code == 303
        yield client


def said(port: int, data: bytes, wait: float = 5.0) -> bytes:
    """What the server answers to raw bytes until it closes the connection."""
    with socket.create_connection(("127.0.0.1", port), timeout=wait) as link:
        with contextlib.suppress(OSError):
            link.sendall(data)
        answer = b""
        with contextlib.suppress(OSError):
            while part := link.recv(65536):
                answer += part
        return answer


def head(port: int, *lines: str, host: str = "") -> bytes:
    return "\r\n".join(["GET /api/session HTTP/1.1", f"Host: {host or f'127.0.0.1:{port}'}", *lines, "", ""]).encode()


@pytest.mark.reliability("studio: another machine, or another address of this one", "nobody listens there")
def test_it_listens_on_loopback_alone(port: int) -> None:
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
    for other in [*others, "127.0.0.2"]:
        with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
            socket.create_connection((str(other), port), timeout=1)


@pytest.mark.reliability(
    "studio: requests without Host, with two, with garbage, broken lengths, a second one inside",
    "400 or closed, never an answer of the API",
)
def test_garbage_on_the_wire(port: int) -> None:
    good = f"127.0.0.1:{port}"
    for data in (
        b"GET /api/session HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01",
        b"GET " + b"/" * 40_000 + b" HTTP/1.1\r\n\r\n",
        head(port, f"Host: {good}"),
        head(port, "Host: evil.example"),
        head(port, "X: " + "y" * 100_000),
        head(port, *[f"X{i}: y" for i in range(5000)]),
        head(port, "Content-Length: -1"),
        head(port, "Content-Length: 1e9"),
        head(port, "Transfer-Encoding: chunked", "Content-Length: 5"),
        b"GET / HTTP/9.9\r\n\r\n",
        b"\0" * 4096,
        head(port, "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: eA=="),
        b"POST /api/edit HTTP/1.1\r\nHost: "
        + good.encode()
        + b"\r\nContent-Length: 3\r\n\r\n{}GET /api/session HTTP/1.1\r\n\r\n",
    ):
        answer = said(port, data)
        assert b"200 OK" not in answer
        assert b"101 " not in answer
        assert b'"server"' not in answer


@pytest.mark.reliability(
    "studio: connections that send their head, or their body, byte by byte or never", "closed in time"
)
def test_slow_senders(port: int) -> None:
    began = time.monotonic()
    assert said(port, b"GET /api/se", wait=8) == b""
    with browser(port) as client:
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
    post = (
        f"POST /api/edit HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nX-Exmesh: 1\r\nContent-Type: application/json\r\n"
        f"Cookie: {cookie}\r\nContent-Length: 100\r\nConnection: close\r\n\r\n{{"
    ).encode()
    assert b" 413 " in said(port, post, wait=8)
    assert time.monotonic() - began < 16


@pytest.mark.thorough
@pytest.mark.reliability(
    "studio: 50 open pages, one of which never reads; more than are allowed",
    "all others hear of an edit; the slow one is told that it lags; 429",
)
def test_fifty_pages_and_a_slow_one(port: int, workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub, "QUEUED", 50)
    monkeypatch.setattr(hub, "MOST_CLIENTS", 51)
    heard = threading.Semaphore(0)
    with browser(port) as client, contextlib.ExitStack() as stack:
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
        slow = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.sendall(head(port, f"Cookie: {cookie}").replace(b"/api/session", b"/api/events"))

        def listen() -> None:
            with contextlib.suppress(httpx.HTTPError), client.stream("GET", "/api/events") as lines:
                for line in lines.iter_lines():
                    if line == "event: document":
                        heard.release()
                        return

        pages = [threading.Thread(target=listen, daemon=True) for _ in range(50)]
        for page in pages:
            page.start()
        end = time.monotonic() + 30
        while len(workspace.hub.clients) < 51 and time.monotonic() < end:
            time.sleep(0.05)
        assert len(workspace.hub.clients) == 51
        assert client.get("/api/events").status_code == 429
        for number in range(3000):  # more than socket and queue of the slow page hold
            workspace.hub.publish("log", {"number": number, "text": "x" * 4000})
        began = time.monotonic()
        assert client.post("/api/edit", json={"ops": [{"set": "n", "to": 2}]}).status_code == 200
        assert all(heard.acquire(timeout=20) for _ in pages)
        assert time.monotonic() - began < 20
        assert max(len(one.queue) for one in workspace.hub.clients) <= 50
        for page in pages:
            page.join(5)


@pytest.mark.reliability("studio: the server ends while pages are open", "their streams end; it ends in time")
def test_the_streams_end_with_the_server(port: int, workspace: Workspace) -> None:
    with browser(port) as client, client.stream("GET", "/api/events") as lines:
        kinds = []
        for line in lines.iter_lines():
            kinds.append(line)
            if line.startswith("data: ") and len(kinds) < 5:
                assert json.loads(line.removeprefix("data: "))["server"] == workspace.server
                workspace.hub.close()
        assert "event: hello" in kinds
