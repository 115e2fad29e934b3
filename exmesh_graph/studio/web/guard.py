"""Who may ask: this machine's browser with the cookie that the token of the URL was exchanged for, and nobody else.

A page of another origin is kept out by Host (DNS rebinding), Origin and Sec-Fetch-Site (forged requests), a cookie
that is SameSite=Strict and out of reach of scripts, and by a header and a content type on everything that changes
something, which no form can send.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

MOST_BYTES = 1 << 20
BODY_SECONDS = 10.0
"""How long a request may take to send its body."""

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; "
    "connect-src 'self' blob:; font-src 'self'; worker-src 'self' blob:; frame-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
SANDBOX = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline' data: blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; connect-src data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'"
)
"""For pages that were made elsewhere (reports, viewers): scripts run, but as of an origin that may ask for nothing."""


class Guard:
    """An ASGI application around another one. `token` is what the URL must name once for each browser.

    A cookie is a random name with its HMAC under `secret`, so that a server that was ended and started again with the
    same secret knows its browsers.
    """

    def __init__(self, app: Any, hosts: set[str], token: str, cookie: str, secret: bytes) -> None:
        self.app, self.hosts, self.token, self.cookie, self.secret = app, hosts, token, cookie, secret

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return  # nothing else is spoken here
        headers = _headers(scope)
        send = _with_headers(send)
        refused = self._refused(scope, headers)
        if refused is None and scope["path"] == "/" and b"token=" in scope.get("query_string", b""):
            await self._log_in(scope, send)
            return
        if refused is None and not self._known(headers):
            refused = 401, "auth", "this browser has no access yet", "open the address that `exmesh studio` printed"
        if refused is not None:
            await _answer(send, refused[0], _error(*refused[1:]))
            return
        await self.app(scope, _Body(receive, send, headers).receive, send)

    def _refused(self, scope: Scope, headers: dict[str, list[str]]) -> tuple[int, str, str, str] | None:
        """(status, code, what, fix) where a request is none of this page's."""
        host, origin = headers.get("host", []), headers.get("origin", [])
        if len(host) != 1 or host[0].lower() not in self.hosts:
            return 403, "forbidden", "the server answers to its own address only", "use the address that was printed"
        if any(one.lower() not in {f"http://{name}" for name in self.hosts} for one in origin):
            return 403, "forbidden", "requests of other pages are not answered", ""
        site = headers.get("sec-fetch-site", ["same-origin"])
        if any(one not in ("same-origin", "none") for one in site):
            return 403, "forbidden", "requests of other pages are not answered", ""
        if scope["method"] not in ("GET", "HEAD", "POST"):
            return 405, "method", f"{scope['method'][:20]} is not spoken here", "GET and POST"
        length = headers.get("content-length", ["0"])
        if len(length) != 1 or not length[0].isdecimal() or int(length[0]) > MOST_BYTES:
            return 413, "large", f"a request holds at most {MOST_BYTES} bytes", ""
        if scope["method"] == "POST":
            kind = headers.get("content-type", [""])[0].partition(";")[0].strip().lower()
            if kind != "application/json" or "x-exmesh" not in headers:
                return 403, "forbidden", "this is no request of the page", "application/json, with X-Exmesh: 1"
        return None

    def _known(self, headers: dict[str, list[str]]) -> bool:
        for line in headers.get("cookie", []):
            for part in line.split(";"):
                name, _, value = part.strip().partition("=")
                login, _, seal = value.partition(".")
                if name == self.cookie and login and hmac.compare_digest(seal.encode(), self._seal(login).encode()):
                    return True
        return False

    def _seal(self, login: str) -> str:
        return hmac.new(self.secret, f"{self.cookie}:{login}".encode(), "sha256").hexdigest()

    async def _log_in(self, scope: Scope, send: Send) -> None:
        """Exchange the token for a cookie of this browser's own."""
        asked = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=10).get("token", [""])
        if len(asked) != 1 or not hmac.compare_digest(asked[0].encode("utf-8", "replace"), self.token.encode()):
            fix = "open the address that `exmesh studio` printed; each start has another one"
            await _answer(send, 401, _error("auth", "this token is not that of this server", fix))
            return
        login = secrets.token_urlsafe(16)
        cookie = f"{self.cookie}={login}.{self._seal(login)}; Path=/; HttpOnly; SameSite=Strict"
        headers = [(b"location", b"/"), (b"set-cookie", cookie.encode()), (b"content-length", b"0")]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})


class TooLarge(Exception):
    """A body that is larger than any the page sends, or that comes too slowly."""


class _Body:
    """Takes a body in, up to its limits."""

    def __init__(self, receive: Receive, send: Send, headers: dict[str, list[str]]) -> None:
        self._receive, self._send, self._left, self._done = receive, send, MOST_BYTES, False
        self._end = asyncio.get_running_loop().time() + BODY_SECONDS

    async def receive(self) -> MutableMapping[str, Any]:
        if self._done:
            return await self._receive()  # of the connection's end
        try:
            async with asyncio.timeout_at(self._end):
                message = await self._receive()
        except TimeoutError:
            raise TooLarge("the request came too slowly") from None
        self._left -= len(message.get("body", b""))
        if self._left < 0:
            raise TooLarge("the request is too large")
        self._done = not message.get("more_body", False)
        return message


def _headers(scope: Scope) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return found


def _with_headers(send: Send) -> Send:
    """Every answer says how little may be done with it, where it does not say so itself."""

    async def answer(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            given = {name.lower() for name, _ in message["headers"]}
            told = {
                b"content-security-policy": POLICY.encode(), b"x-content-type-options": b"nosniff",
                b"referrer-policy": b"no-referrer", b"cross-origin-opener-policy": b"same-origin",
                b"cross-origin-resource-policy": b"same-origin", b"cache-control": b"no-store",
            }  # fmt: skip
            extra = [(name, value) for name, value in told.items() if name not in given]
            message = {**message, "headers": [*message["headers"], *extra]}
        await send(message)

    return answer


def _error(code: str, what: str, fix: str) -> bytes:
    told = {"code": code, "what": what, "where": "", "expected": "", "fix": fix, "problems": []}
    return json.dumps({"error": told}).encode()


async def _answer(send: Send, status: int, body: bytes) -> None:
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode()),
               (b"connection", b"close")]  # fmt: skip
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
