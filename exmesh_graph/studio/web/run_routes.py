"""Endpoints of runs: the list, one run with its nodes, logs and curves; starting, stopping and going on."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route

from exmesh_graph.graph.run.rundir import log_file
from exmesh_graph.studio.rungraph import RunGraph
from exmesh_graph.studio.runview import RunView, is_own_file, log_lines
from exmesh_graph.studio.web.answers import Query, Unknown, asked, error_answer, json_answer, posted
from exmesh_graph.studio.web.guard import SANDBOX
from exmesh_graph.studio.workspace import Workspace

_LOG_BYTES = 256 << 10


def runs(workspace: Workspace, query: Query) -> Any:
    ours, labels = workspace.jobs.ours(), workspace.labels.all()
    with workspace.watcher.lock:
        views = workspace.watcher.all(query.whole("last", 50, 1, 200))
        return {"runs": [{**v.facts(), "ours": v.id in ours, "label": labels.get(v.id, "")} for v in views]}


def run(workspace: Workspace, query: Query) -> Any:
    view = view_of(workspace, query)
    with workspace.watcher.lock:
        record = view.record
        return {
            **(workspace.run_facts(view.id) or {}), "nodes_detail": view.details(), "resolved": record.get("resolved"),
            "command": record.get("command", ""), "params": (record.get("resolved") or {}).get("params") or {},
            "published": record.get("published") or {}, "machine": record.get("machine") or {},
            "overrides": record.get("overrides") or [],
        }  # fmt: skip


def graph(workspace: Workspace, query: Query) -> Any:
    """The graph as the run ran it, from its record."""
    view = view_of(workspace, query)
    with workspace.watcher.lock:
        resolved = view.record.get("resolved")
    if not isinstance(resolved, dict) or not resolved.get("nodes"):
        raise Unknown(f"the record of {view.id} does not tell its graph")
    return RunGraph(resolved, workspace.document.types).answer()


def curves(workspace: Workspace, query: Query) -> Any:
    view = view_of(workspace, query)
    with workspace.watcher.lock:
        return {"curves": view.curve_facts(query.get("node", ""))}


def log(workspace: Workspace, query: Query) -> Any:
    """Events of a node, and what it printed from `offset` on."""
    view, node, offset = view_of(workspace, query), query.get("node", ""), query.whole("offset", 0)
    lines: list[dict[str, Any]] = []
    if offset == 0:
        with (view.folder / "events.jsonl").open(encoding="utf-8", errors="replace") as events:
            lines = list(itertools.islice(log_lines(events, node), 5000))
    printed = log_file(view.folder, node) if node else None
    if printed is not None and is_own_file(printed, view.folder):
        with printed.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(offset, size - _LOG_BYTES) if offset == 0 else min(offset, size))
            data = file.read(_LOG_BYTES)
            offset = file.tell()
        lines += [{"kind": "printed", "time": 0, "node": node, "text": text} for text in
                  data.decode("utf-8", "replace").splitlines()]  # fmt: skip
    return {"lines": lines, "offset": offset, "end": view.state not in ("running", "stopping")}


def report(workspace: Workspace, query: Query) -> Any:
    return page_of(view_of(workspace, query), "report.html")


def start(workspace: Workspace, body: dict[str, Any]) -> Any:
    return started(workspace, workspace.start_run(body))


def stop(workspace: Workspace, body: dict[str, Any]) -> Any:
    view = view_of(workspace, body)
    workspace.jobs.stop(view.folder)
    with workspace.watcher.lock:  # so that no end that is noted meanwhile is told before this
        view.stopping = True
        workspace.hub.publish("run", view.facts())
    return {"run": workspace.run_facts(view.id)}


def resume(workspace: Workspace, body: dict[str, Any]) -> Any:
    view = view_of(workspace, body)
    return started(workspace, workspace.resume(view))


def started(workspace: Workspace, job: str) -> Response:
    """The answer to what starts a run: 202, with the run where it has begun by then."""
    name = workspace.jobs.run_of(job, 6.0)
    if name:
        workspace.watcher.look()
    run = workspace.run_facts(name) if name else None
    return json_answer({"run": run or {"id": name, "state": "starting"}, "job": job}, 202)


def view_of(workspace: Workspace, query: Any) -> RunView:
    """The run that a request names. Raises Unknown."""
    name = str(query.get("id") or "")
    view = workspace.watcher.view(name) if name and name == Path(name).name else None
    if view is None:
        raise Unknown(f"there is no run {name[:80]!r}", expected="GET /api/runs lists them")
    return view


def page_of(view: RunView, name: str) -> Response:
    """A page that a run left, sandboxed: its scripts run, but cannot ask this server for anything."""
    path = view.folder / name
    if not is_own_file(path, view.folder):
        raise Unknown(f"there is no {name} yet")
    return FileResponse(path, media_type="text/html", headers={"content-security-policy": SANDBOX})


async def events(request: Request) -> Response:
    """The stream of all that happens."""
    workspace: Workspace = request.app.state.workspace
    client = workspace.hub.open()
    if client is None:
        return error_answer(429, {"code": "busy", "what": "too many pages are open", "fix": "close some"})
    hello = {"revision": workspace.document.revision, "events": workspace.hub.number, **workspace.session_facts()}
    return StreamingResponse(workspace.hub.stream(client, hello), media_type="text/event-stream",
                             headers={"x-accel-buffering": "no"})  # fmt: skip


ROUTES = [
    Route("/api/events", events),
    Route("/api/runs", asked(runs), methods=["GET"]),
    Route("/api/runs", posted(start), methods=["POST"]),
    Route("/api/runs/stop", posted(stop), methods=["POST"]),
    Route("/api/runs/resume", posted(resume), methods=["POST"]),
    Route("/api/runs/{id}", asked(run)),
    Route("/api/runs/{id}/graph", asked(graph)),
    Route("/api/runs/{id}/curves", asked(curves)),
    Route("/api/runs/{id}/log", asked(log)),
    Route("/api/runs/{id}/report", asked(report)),
]
