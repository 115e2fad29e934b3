"""The application: routes, the page's files, and the guard around all of it."""

from __future__ import annotations

import contextlib
import gzip
import secrets
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from exmesh_graph.studio.web import compare_routes, graph_routes, look_routes, run_routes
from exmesh_graph.studio.web.answers import error_answer
from exmesh_graph.studio.web.guard import Guard
from exmesh_graph.studio.workspace import Workspace

STATIC = Path(__file__).parent.parent / "static"
VENDOR = Path(__file__).parent.parent.parent / "report" / "view" / "vendor"
_KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json",
          ".svg": "image/svg+xml", ".png": "image/png", ".woff2": "font/woff2", ".wasm": "application/wasm",
          ".txt": "text/plain", ".map": "application/json", ".ico": "image/x-icon"}  # fmt: skip


_PACKED: dict[Path, tuple[int, bytes]] = {}


def application(
    workspace: Workspace, hosts: set[str], token: str, cookie: str = "exmesh_studio", secret: bytes = b""
) -> Any:
    """The ASGI application. `hosts` are the values of Host that are its own; `secret` seals cookies (see `guard`)."""

    @contextlib.asynccontextmanager
    async def living(app: Starlette) -> AsyncIterator[None]:
        workspace.start()
        for path in (STATIC / "assets").glob("index-*"):
            _packed(path, _KINDS[path.suffix])
        yield
        workspace.close()

    app = Starlette(
        routes=[
            Route("/", page), Route("/static/{path:path}", static), Route("/assets/{path:path}", vendored),
            *graph_routes.ROUTES, *compare_routes.ROUTES, *run_routes.ROUTES,
            *look_routes.ROUTES,
        ],
        middleware=[Middleware(GZipMiddleware, minimum_size=20_000, compresslevel=3)],
        exception_handlers={404: _not_found, 405: _not_allowed, Exception: _broken},
        lifespan=living,
    )  # fmt: skip
    app.state.workspace = workspace
    return Guard(app, {host.lower() for host in hosts}, token, cookie, secret or secrets.token_bytes(32))


async def page(request: Request) -> Response:
    return _file(STATIC, "index.html")


async def static(request: Request) -> Response:
    answer = _file(STATIC, request.path_params["path"])
    asked = request.headers
    if isinstance(answer, FileResponse) and "gzip" in asked.get("accept-encoding", "") and "range" not in asked:
        return _packed(Path(answer.path), str(answer.media_type))
    return answer


async def vendored(request: Request) -> Response:
    return _file(VENDOR, request.path_params["path"])


def _file(home: Path, name: str) -> Response:
    """A file of the page; what leads out of its folder is not there."""
    path = (home / name).resolve() if "\0" not in name else home
    if not path.is_relative_to(home.resolve()) or not path.is_file() or path.suffix not in _KINDS:
        return error_answer(404, {"code": "unknown", "what": f"there is no file {name[:80]!r}"})
    return FileResponse(path, media_type=_KINDS[path.suffix], headers={"cache-control": "no-cache"})


def _packed(path: Path, kind: str) -> Response:
    """A file of the page, compressed once: while a graph is read, a stream of small pieces would wait for each."""
    status = path.stat()
    known = _PACKED.get(path)
    if known is None or known[0] != status.st_mtime_ns:
        known = _PACKED[path] = status.st_mtime_ns, gzip.compress(path.read_bytes(), 6, mtime=0)
    headers = {"cache-control": "no-cache", "content-encoding": "gzip", "vary": "Accept-Encoding"}
    return Response(known[1], media_type=kind, headers=headers)


async def _not_found(request: Request, error: Exception) -> Response:
    return error_answer(404, {"code": "unknown", "what": f"there is no {request.url.path[:80]}"})


async def _not_allowed(request: Request, error: Exception) -> Response:
    return error_answer(405, {"code": "method", "what": f"{request.method} is not for {request.url.path[:80]}"})


async def _broken(request: Request, error: Exception) -> Response:
    what = f"{type(error).__name__}: {str(error)[:300]}"
    return error_answer(500, {"code": "server", "what": what, "fix": "a fault of the studio: tell us"})
