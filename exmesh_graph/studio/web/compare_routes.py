"""Endpoints that compare: ablations of the open graph, sweeps, two runs side by side, figures."""

from __future__ import annotations

from typing import Any

from starlette.responses import Response
from starlette.routing import Route

from exmesh_graph.api.results import load_artifact
from exmesh_graph.errors import GraphError
from exmesh_graph.studio.ablation import Refused, study_lines, study_plan, study_tree, without_each
from exmesh_graph.studio.comparing import headline_of, pair_facts, sweep_facts
from exmesh_graph.studio.copies import text_of, written_copy
from exmesh_graph.studio.places import Conflict, write_text
from exmesh_graph.studio.runview import is_own_file
from exmesh_graph.studio.web.answers import BadRequest, Query, Unknown, asked, posted
from exmesh_graph.studio.web.run_routes import page_of, started, view_of
from exmesh_graph.studio.workspace import Workspace


def ablation(workspace: Workspace, body: dict[str, Any]) -> Any:
    """Variants without each marked thing, their file and what a sweep of them would run; written with `save` only."""
    document = workspace.document
    variants = without_each(document, _names(body.get("nodes")))
    told: dict[str, Any] = {"variants": [one.as_json() for one in variants], "text": "", "plan": None, "saved": ""}
    lines = study_lines(variants)
    if not lines:
        return told
    with document.lock:
        top = study_tree(document, lines, _repeats(body))
        if body.get("name"):
            top.put("name", str(body["name"])[:80], top.where)
        told["text"] = text_of(top, document.file, document.file.parent)
        told["plan"] = study_plan(document, top, workspace.store())
    if body.get("save"):
        path = workspace.places.graph_file(str(body["save"]), new=True)
        if path.parent.resolve() != document.file.parent.resolve():
            raise BadRequest("a file of variants stands beside the graph", expected=str(document.file.parent))
        if path.exists():
            raise Conflict(f"{path.name} is there already", fix="choose another name")
        write_text(path, told["text"])
        told["saved"] = path.name
    return told


def sweep(workspace: Workspace, body: dict[str, Any]) -> Any:
    """Sweep marked things, given variants, or a file that declares some; in a process of its own."""
    document, only = workspace.document, None
    if body.get("file"):
        graph = workspace.places.graph_file(str(body["file"]))
        only = _names(body["only"]) if body.get("only") else None
    else:
        given = body.get("variants")
        if given is not None and not (
            isinstance(given, dict) and given and all(isinstance(ops, list) for ops in given.values())
        ):
            raise BadRequest("variants maps names to lists of patches")
        with document.lock:
            lines = given or study_lines(without_each(document, _names(body.get("nodes"))))
            if not lines:
                raise Refused("nothing that was marked can be left out", fix="POST /api/ablation says why")
            top = study_tree(document, lines, _repeats(body))
            study_plan(document, top, workspace.store())  # raises the faults of all variants
            graph = written_copy(top, document.file, workspace.store_folder / "studio" / "graphs")
    return started(workspace, workspace.start_job({
        "kind": "sweep", "graph": str(graph), "variant": "", "nodes": None, "force": None, "set": None,
        "workers": _workers(body), "keep_going": True, "only": only,
    }))  # fmt: skip


def sweep_table(workspace: Workspace, query: Query) -> Any:
    view = view_of(workspace, query)
    table = sweep_facts(view.folder) if is_own_file(view.folder / "sweep.json", view.folder) else None
    if table is None:
        raise Unknown(f"{view.id} has no table yet", fix="it comes when the sweep has ended")
    return {"table": table, "page": f"/api/runs/{view.id}/sweep.html"}


def sweep_page(workspace: Workspace, query: Query) -> Response:
    return page_of(view_of(workspace, query), "sweep.html")


def figures(workspace: Workspace, query: Query) -> Any:
    view = view_of(workspace, query)
    with workspace.watcher.lock:
        record = dict(view.record)
    return headline_of(view.folder, record, lambda digest: load_artifact(workspace.store(), digest))


def compare(workspace: Workspace, query: Query) -> Any:
    a, b = (view_of(workspace, {"id": query.needed(side)}) for side in ("a", "b"))
    return {"a": a.id, "b": b.id, **pair_facts(a.folder, b.folder)}


def label(workspace: Workspace, body: dict[str, Any]) -> Any:
    view = view_of(workspace, body)
    workspace.labels.put(view.id, str(body.get("label") or ""))
    workspace.hub.publish("runs", {"id": view.id})
    return {"run": workspace.run_facts(view.id)}


ROUTES = [
    Route("/api/ablation", posted(ablation), methods=["POST"]),
    Route("/api/sweep", posted(sweep), methods=["POST"]),
    Route("/api/compare", asked(compare)),
    Route("/api/runs/label", posted(label), methods=["POST"]),
    Route("/api/runs/{id}/figures", asked(figures)),
    Route("/api/runs/{id}/sweep", asked(sweep_table)),
    Route("/api/runs/{id}/sweep.html", asked(sweep_page)),
]


def _names(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
        raise BadRequest("nodes is a list of names")
    return value


def _repeats(body: dict[str, Any]) -> int:
    value = body.get("repeats", 1)
    if not isinstance(value, int) or isinstance(value, bool):
        raise GraphError(f"repeats is {value!r}", expected="a whole number")
    return value


def _workers(body: dict[str, Any]) -> int | None:
    value = body.get("workers")
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= 256):
        raise BadRequest(f"workers is {str(value)[:40]}", expected="a whole number from 0 to 256")
    return value
