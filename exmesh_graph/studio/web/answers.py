"""What endpoints share: the body of a request, JSON answers, errors in the one form that the page knows."""

from __future__ import annotations

import functools
import json
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from exmesh_graph.errors import ExmeshError
from exmesh_graph.studio.faults import error_facts
from exmesh_graph.studio.web.guard import TooLarge
from exmesh_graph.studio.workspace import Workspace

_STATUS = {"graph": 422, "data": 422, "store": 410, "unknown": 404, "conflict": 409, "bad-request": 400, "busy": 429,
           "name": 404, "geometry": 422, "numerics": 422}  # fmt: skip


class BadRequest(ExmeshError):
    """A request that is not what the endpoint takes."""

    code = "bad-request"


class Unknown(ExmeshError):
    """Something that is not there."""

    code = "unknown"


Work = Callable[[Workspace, Any], Any]


def asked(work: Callable[[Workspace, Query], Any]) -> Callable[[Request], Awaitable[Response]]:
    """The endpoint of a GET: `work` gets the query, and gives JSON or a Response; it runs in a thread."""

    @functools.wraps(work)
    async def endpoint(request: Request) -> Response:
        query = Query(request)
        return await _worked(request, lambda: work(request.app.state.workspace, query))

    return endpoint


def posted(work: Callable[[Workspace, dict[str, Any]], Any]) -> Callable[[Request], Awaitable[Response]]:
    """The endpoint of a POST: `work` gets the JSON object of the body."""

    @functools.wraps(work)
    async def endpoint(request: Request) -> Response:
        try:
            body = _parsed(await request.body())
        except TooLarge as error:
            return error_answer(413, {"code": "large", "what": str(error)})
        except ExmeshError as error:
            return error_answer(400, error_facts(error))
        return await _worked(request, lambda: work(request.app.state.workspace, body))

    return endpoint


class Query(Mapping[str, str]):
    """The query of a request, and the parts of its path."""

    def __init__(self, request: Request) -> None:
        self._one = {**dict(request.query_params), **{k: str(v) for k, v in request.path_params.items()}}
        self._all = request.query_params
        self.headers = request.headers

    def __getitem__(self, name: str) -> str:
        return self._one[name]

    def __iter__(self) -> Any:
        return iter(self._one)

    def __len__(self) -> int:
        return len(self._one)

    def every(self, name: str) -> list[str]:
        """All values of a name that may stand several times."""
        return self._all.getlist(name)

    def needed(self, name: str) -> str:
        """A value that must be there. Raises BadRequest."""
        if not self._one.get(name):
            raise BadRequest(f"the request lacks {name}")
        return self._one[name]

    def whole(self, name: str, default: int, least: int = 0, most: int = 1 << 31) -> int:
        """A whole number within limits. Raises BadRequest."""
        text = self._one.get(name, "")
        try:
            value = int(text) if text else default
        except ValueError:
            raise BadRequest(f"{name} is no whole number: {text[:40]!r}") from None
        if not least <= value <= most:
            raise BadRequest(f"{name} is {value}", expected=f"{least} to {most}")
        return value


def json_answer(value: Any, status: int = 200) -> Response:
    """A JSON answer; what is no JSON in it becomes text."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return Response(text.encode("utf-8", "replace"), status, media_type="application/json")


def error_answer(status: int, error: Mapping[str, Any]) -> Response:
    told = {"code": "server", "what": "", "where": "", "expected": "", "fix": "", "problems": [], **error}
    return json_answer({"error": told}, status)


def of_error(error: ExmeshError, workspace: Workspace) -> Response:
    """An error of the library as an answer."""
    code = getattr(error, "code", "error")
    return error_answer(_STATUS.get(code, 422), error_facts(error, workspace.node_names(), workspace.folder))


async def _worked(request: Request, work: Callable[[], Any]) -> Response:
    workspace: Workspace = request.app.state.workspace
    try:
        result = await run_in_threadpool(_within, workspace, work)
    except ExmeshError as error:
        return of_error(error, workspace)
    except RecursionError:
        return error_answer(400, {"code": "bad-request", "what": "the request nests too deep"})
    return result if isinstance(result, Response) else json_answer(result)


def _within(workspace: Workspace, work: Callable[[], Any]) -> Any:
    with workspace.session:
        return work()


def _parsed(raw: bytes) -> dict[str, Any]:
    try:
        body = json.loads(raw or b"{}", parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise BadRequest(f"the body is no JSON: {str(error)[:100]}") from None
    if not isinstance(body, dict):
        raise BadRequest("the body is no JSON object")
    return body


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no JSON")
