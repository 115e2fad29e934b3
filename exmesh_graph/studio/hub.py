"""Events to all open pages: each has a short queue of its own, so that a slow one holds up nobody."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections import deque
from collections.abc import AsyncIterator, Mapping
from typing import Any

MOST_CLIENTS = 64
QUEUED = 1000
HEARTBEAT = 10.0
"""Seconds between comments that keep a quiet connection open, and show a closed one."""


class Client:
    """One open page. `put` may be called from any thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop, self.ready = loop, asyncio.Event()
        self.queue: deque[str] = deque()
        self.lagged = self.closed = False

    def put(self, text: str) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: the server ends
            self.loop.call_soon_threadsafe(self._put, text)

    def close(self) -> None:
        """Let its stream end."""
        self.closed = True
        self.put("")

    def _put(self, text: str) -> None:
        if len(self.queue) >= QUEUED:
            self.queue.clear()
            self.lagged = True
        if text:
            self.queue.append(text)
        self.ready.set()


class Hub:
    """All open pages."""

    def __init__(self) -> None:
        self.clients: set[Client] = set()
        self._lock = threading.Lock()
        self.number = 0  # of the last event

    def publish(self, kind: str, data: Mapping[str, Any]) -> None:
        """Send an event to all pages; from any thread."""
        with self._lock:
            self.number += 1
            clients, number = list(self.clients), self.number
        if clients:
            text = framed(kind, data, number)
            for client in clients:
                client.put(text)

    def close(self) -> None:
        """End all streams."""
        with self._lock:
            for client in self.clients:
                client.close()

    def open(self) -> Client | None:
        """A new page; None where there are too many. To be called on the server's loop."""
        with self._lock:
            if len(self.clients) >= MOST_CLIENTS:
                return None
            client = Client(asyncio.get_running_loop())
            self.clients.add(client)
            return client

    def leave(self, client: Client) -> None:
        with self._lock:
            self.clients.discard(client)

    async def stream(self, client: Client, hello: Mapping[str, Any]) -> AsyncIterator[str]:
        """The text of a page's event stream, until it is closed."""
        try:
            yield framed("hello", hello, 0)
            while not client.closed:
                client.ready.clear()
                if not client.queue and not client.lagged:
                    try:
                        await asyncio.wait_for(client.ready.wait(), HEARTBEAT)
                    except TimeoutError:
                        yield ": still here\n\n"
                        continue
                if client.lagged:
                    client.lagged = False
                    yield framed("lagged", {}, 0)
                if client.queue:
                    text = "".join(client.queue)  # together: each piece wakes several processes of a browser
                    client.queue.clear()
                    yield text
        finally:
            self.leave(client)


def framed(kind: str, data: Mapping[str, Any], number: int) -> str:
    """An event as text/event-stream has it."""
    return f"event: {kind}\nid: {number}\ndata: {json.dumps(data, default=str)}\n\n"
