"""Serving a workspace on this machine alone, with a token that is in the printed address and nowhere else."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError, MissingLibraryError
from exmesh_graph.studio.workspace import Workspace

HOST = "127.0.0.1"
_HEAD_SECONDS = 10.0
_MOST_CONNECTIONS = 256
_TICK = 0.5
"""Seconds between two looks at whether the server shall end."""


def serve(workspace: Workspace, port: int = 0, ready: Callable[[str], None] | None = None) -> None:
    """Serve until Ctrl-C; `ready` is called with the address once the server listens.

    port  0: any that is free. Raises MissingLibraryError without the extra `studio`, ExmeshError for a taken port.
    """
    uvicorn = _library()
    home = workspace.store_folder / "studio"
    listener = _listener(port or remembered_port(home), port == 0)
    number = int(listener.getsockname()[1])
    remember_port(home, number)
    token = secrets.token_urlsafe(32)

    class Server(uvicorn.Server):  # type: ignore[misc,name-defined]
        async def main_loop(self) -> None:
            while not await self.on_tick(0):  # uvicorn's own looks ten times a second, which a watched run pays for
                await asyncio.sleep(_TICK)

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            workspace.hub.close()  # else it waits for the streams of open pages, and then complains of them
            await super().shutdown(sockets)

    server = Server(configuration(workspace, number, token))
    address = f"http://{HOST}:{number}/?token={token}"

    async def run() -> None:
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        while not server.started and not serving.done():
            await asyncio.sleep(0.01)
        if ready is not None and server.started:
            ready(address)
        await serving

    try:
        asyncio.run(run())
    finally:
        listener.close()


def configuration(workspace: Workspace, port: int, token: str) -> Any:
    """How uvicorn serves a workspace."""
    uvicorn = _library()
    from exmesh_graph.studio.web.app import application

    hosts = {f"{name}:{port}" for name in (HOST, "localhost")}
    app = application(workspace, hosts, token, f"exmesh_studio_{port}", secret_of(workspace.store_folder / "studio"))
    return uvicorn.Config(
        app, host=HOST, port=port, http=_protocol(), ws="none", lifespan="on", log_level="error", access_log=False,
        server_header=False, proxy_headers=False, limit_concurrency=_MOST_CONNECTIONS, timeout_keep_alive=20,
        timeout_graceful_shutdown=2, h11_max_incomplete_event_size=16 << 10,
    )  # fmt: skip


def secret_of(home: Path) -> bytes:
    """What cookies of this store's studios are sealed with: made once, readable by its user alone."""
    file = home / "secret"
    with contextlib.suppress(OSError):
        status = file.lstat()
        if stat.S_ISREG(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077:
            known = file.read_bytes()
            if len(known) == 32:
                return known
    made = secrets.token_bytes(32)
    with contextlib.suppress(OSError):  # a store that cannot be written: browsers are asked again after a restart
        home.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)
        with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
            out.write(made)
    return made


def remembered_port(home: Path) -> int:
    """The port of the last studio over this store, so that open pages find it again; 0 where there was none."""
    with contextlib.suppress(OSError, ValueError):
        number = int((home / "port").read_text(encoding="ascii"))
        return number if 1024 <= number <= 65535 else 0
    return 0


def remember_port(home: Path, number: int) -> None:
    with contextlib.suppress(OSError):
        home.mkdir(parents=True, exist_ok=True)
        (home / "port").write_text(f"{number}\n", encoding="ascii")


def _protocol() -> Any:
    """HTTP/1.1 that lets go of connections which do not send a request's head in time."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Patient(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.loop.call_later(_HEAD_SECONDS, self._let_go)

        def _let_go(self) -> None:
            if self.cycle is None and not self.transport.is_closing():
                self.transport.close()

    return Patient


def _listener(port: int, any_other: bool = False) -> socket.socket:
    """A socket on this machine's own address; with `any_other` a free port where the wanted one is taken."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except OSError as error:
        listener.close()
        if any_other and port:
            return _listener(0)
        fix = "leave out --port, or name another"
        raise ExmeshError(f"port {port} cannot be used: {error.strerror}", fix=fix) from error
    return listener


def _library() -> Any:
    try:
        import starlette  # noqa: F401
        import uvicorn
    except ImportError as error:
        what = f"exmesh studio needs {error.name}, which is not installed"
        raise MissingLibraryError(what, fix="pip install 'exmesh-graph[studio]'") from error
    return uvicorn
