"""Endpoints of the open graph: document, catalog, plan, edits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from starlette.routing import Route

from exmesh_graph.errors import GraphError
from exmesh_graph.studio.places import Conflict
from exmesh_graph.studio.web.answers import BadRequest, Query, asked, posted
from exmesh_graph.studio.workspace import Workspace

MOST_OPS = 200


def document(workspace: Workspace, query: Query) -> Any:
    return workspace.facts(wait=0)  # a plan that is not ready yet is told of later: the page draws the graph meanwhile


def catalog(workspace: Workspace, query: Query) -> Any:
    return workspace.document.types.all()


def search(workspace: Workspace, query: Query) -> Any:
    return {"types": workspace.document.types.search(query.get("q", "")[:200], query.whole("limit", 30, 1, 500))}


def plan(workspace: Workspace, query: Query) -> Any:
    told = workspace.plan(query.every("nodes"))
    return {"revision": workspace.document.revision, "plan": told}


def why(workspace: Workspace, query: Query) -> Any:
    return workspace.why(query.needed("node"))


def ends(workspace: Workspace, query: Query) -> Any:
    node, port, side = query.needed("node"), query.get("port", ""), query.get("side", "")
    told = workspace.document.ends(f"{node}." if side == "inputs" else node)
    return told.for_output(node, port, side) if query.get("output") else told.for_input(node, port, side)


def swaps(workspace: Workspace, query: Query) -> Any:
    node = query.needed("node")
    return {"types": workspace.document.ends(node).swaps(node)}


def text(workspace: Workspace, query: Query) -> Any:
    return workspace.text()


def save(workspace: Workspace, body: dict[str, Any]) -> Any:
    path = workspace.save(body)
    return {"saved": path.name, "document": _stepped(workspace, body, "save", True)}


def edit(workspace: Workspace, body: dict[str, Any]) -> Any:
    ops = _ops(workspace, body)
    workspace.document.edit(ops)
    workspace.changed("edit", _by(body))
    return workspace.facts()


def attempt(workspace: Workspace, body: dict[str, Any]) -> Any:
    after = workspace.document.after(_ops(workspace, body))
    return {"ok": True, "document": workspace.facts(after)}


def undo(workspace: Workspace, body: dict[str, Any]) -> Any:
    return _stepped(workspace, body, "undo", workspace.document.undo())


def redo(workspace: Workspace, body: dict[str, Any]) -> Any:
    return _stepped(workspace, body, "undo", workspace.document.redo())


def revert(workspace: Workspace, body: dict[str, Any]) -> Any:
    workspace.document.revert()
    return _stepped(workspace, body, "edit", True)


def reload(workspace: Workspace, body: dict[str, Any]) -> Any:
    lost = workspace.document.reload()
    return {**_stepped(workspace, body, "disk", True), "lost": list(lost)}


def graphs(workspace: Workspace, query: Query) -> Any:
    return {"graphs": workspace.places.graphs()}


def open_graph(workspace: Workspace, body: dict[str, Any]) -> Any:
    if workspace.document.dirty and not body.get("discard"):
        raise Conflict("the open graph has edits that are not saved", fix='save them, or send "discard": true')
    workspace.open(str(body.get("file", "")), str(body.get("variant") or ""))
    return _stepped(workspace, body, "open", True)


def session(workspace: Workspace, query: Query) -> Any:
    return workspace.session_facts()


ROUTES = [
    Route("/api/session", asked(session)),
    Route("/api/document", asked(document)),
    Route("/api/catalog", asked(catalog)),
    Route("/api/catalog/search", asked(search)),
    Route("/api/plan", asked(plan)),
    Route("/api/why", asked(why)),
    Route("/api/graphs", asked(graphs)),
    Route("/api/ends", asked(ends)),
    Route("/api/swaps", asked(swaps)),
    Route("/api/text", asked(text)),
    Route("/api/save", posted(save), methods=["POST"]),
    Route("/api/edit", posted(edit), methods=["POST"]),
    Route("/api/try", posted(attempt), methods=["POST"]),
    Route("/api/undo", posted(undo), methods=["POST"]),
    Route("/api/redo", posted(redo), methods=["POST"]),
    Route("/api/revert", posted(revert), methods=["POST"]),
    Route("/api/reload", posted(reload), methods=["POST"]),
    Route("/api/open", posted(open_graph), methods=["POST"]),
]


def _ops(workspace: Workspace, body: Mapping[str, Any]) -> list[Any]:
    ops = body.get("ops")
    if not isinstance(ops, list) or not ops:
        raise BadRequest("the request lacks ops", expected='{"ops": [{"set": "node.parameter", "to": value}]}')
    if len(ops) > MOST_OPS:
        raise BadRequest(f"an edit has {len(ops)} operations", expected=f"at most {MOST_OPS}")
    revision = body.get("revision")
    if revision is not None and revision != workspace.document.revision:
        raise Conflict(f"the graph is at revision {workspace.document.revision}, not {revision}",
                       fix="GET /api/document, then edit that")  # fmt: skip
    return ops


def _stepped(workspace: Workspace, body: Mapping[str, Any], what: str, moved: bool) -> dict[str, Any]:
    if not moved:
        raise GraphError("there is nothing to go back or forward to")
    workspace.changed(what, _by(body))
    return workspace.facts()


def _by(body: Mapping[str, Any]) -> str:
    return str(body.get("by") or "")[:64]
