"""What a server has open: one graph with its edits, the store, the runs, and the pages that look on."""

from __future__ import annotations

import os
import re
import secrets
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from exmesh_graph.api.opening import open_store
from exmesh_graph.api.planning import why_of
from exmesh_graph.api.results import read_run
from exmesh_graph.api.selecting import selected
from exmesh_graph.errors import ExmeshError, GraphError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.session import current_session, store_folder
from exmesh_graph.graph.variants.declared import BASE
from exmesh_graph.studio.artifacts.shelf import Shelf
from exmesh_graph.studio.copies import written_copy
from exmesh_graph.studio.document import Document, variant_ops
from exmesh_graph.studio.edits import Op
from exmesh_graph.studio.faults import error_facts
from exmesh_graph.studio.hub import Hub
from exmesh_graph.studio.jobs import Jobs
from exmesh_graph.studio.labels import Labels
from exmesh_graph.studio.places import Conflict, Outside, Places, write_text
from exmesh_graph.studio.planner import Planner
from exmesh_graph.studio.plans import plan_facts
from exmesh_graph.studio.runview import RunView
from exmesh_graph.studio.saving import child_text, difference, edited_text, ops_text, variant_text
from exmesh_graph.studio.watching import Watcher
from exmesh_graph.version import __version__

PLAN_WAIT = 0.4
"""Seconds that an answer waits for its plan; a later one is told of by the event `plan`."""


class Workspace:
    """See the top of this module. `close` ends the following of runs; the runs themselves go on."""

    def __init__(
        self,
        graph: Path,
        *,
        store: Path | None = None,
        shared: str | None = None,
        runs: Path = Path("runs"),
        variant: str = "",
        sets: Sequence[str] = (),
        run: str = "",
    ) -> None:
        self.server = secrets.token_hex(8)
        self.session = current_session()
        self.session.packs()
        self.store_folder, self.shared, self.runs = store_folder(store), shared, runs.absolute()
        self.file = graph.absolute()
        self.folder, self.shown_run = self.file.parent, run
        self.lock = threading.RLock()
        self.hub = Hub()
        self.jobs = Jobs(self.store_folder, self.runs)
        self.watcher = Watcher(self.runs, self.hub.publish, self._ran, self._look_at_disk)
        self._told_disk = (0, False)  # of which document, and whether its files were changed
        self.labels = Labels(self.store_folder / "studio" / "labels.json")
        self.shelf = Shelf(self.store)
        self.planner = Planner(self._store_and_code)
        self.places = Places(self.folder, self.store_folder / "studio" / "graphs", self.runs)
        self.document = self._opened(self.file, variant, [_as_edit(text) for text in sets])

    @classmethod
    def of_run(cls, folder: Path, *, store: Path | None = None, shared: str | None = None) -> Workspace:
        """The graph that a run ran, with what was set then; its runs are those of the folder's own folder."""
        record = read_run(folder)
        file = Path(str(record.get("file") or ""))
        if not file.is_file():
            raise ExmeshError(f"the graph of the run is gone: {file}", where=str(folder), fix="name the graph file")
        sets = [str(text) for text in record.get("overrides") or ()]
        used = store or (Path(str(record["store"])) if Path(str(record.get("store", ""))).is_dir() else None)
        variant = str((record.get("resolved") or {}).get("variant") or "")
        real = folder.resolve()
        return cls(file, store=used, shared=shared, runs=real.parent, variant=variant, sets=sets, run=real.name)

    def start(self) -> None:
        """Begin to follow the runs; check, read and begin to plan the graph before the first page asks for it."""
        self.jobs.sweep()
        self.watcher.start()
        self.document.facts()
        self.planner.ahead(self.document.judged())

    def close(self) -> None:
        self.hub.close()
        self.watcher.close()
        self.planner.close()

    # --- the document

    def facts(self, ops: Sequence[Op] | None = None, wait: float = PLAN_WAIT) -> dict[str, Any]:
        """DOCUMENT of the contract, with its plan where that is ready in time."""
        document, events = self.document, self.hub.number
        with document.lock:
            judged = document.judged(ops)
            told = document.facts(ops)
        told |= {"events": events, "store": str(self.store_folder), "runs": str(self.runs), "run": self.shown_run,
                 "plan": None, "plan_pending": False}  # fmt: skip
        if judged.checked is not None:
            if ops is None:
                told["plan"] = self.planner.soon(judged, wait, lambda: self._tell_plan(document.revision))
                told["plan_pending"] = told["plan"] is None
            else:
                told["plan"] = plan_facts(judged.checked, self.store())
        told["patch"] = ops_text(told["ops"])
        return told

    def plan(self, nodes: Iterable[str] = ()) -> dict[str, Any] | None:
        """The plan of the open graph, or of what some nodes need; None where it has faults."""
        document = self.document
        judged = document.judged()
        if judged.checked is None:
            return None
        names = list(nodes)
        if names:
            chosen = selected(judged.checked, names)
            return plan_facts(chosen.graph, self.store(), chosen.targets)
        return self.planner.plan(judged)

    def open(self, name: str, variant: str = "") -> None:
        """Open another graph file of the folder. Raises Outside, GraphErrors."""
        file = self.places.graph_file(name)
        document = self._opened(file, variant, ())
        with self.lock:
            document.revision = self.document.revision + 1
            self.document = document

    def changed(self, what: str, by: str = "") -> None:
        """Tell all pages that the document changed."""
        self.hub.publish("document", {"revision": self.document.revision, "by": by, "what": what})

    def text(self) -> dict[str, Any]:
        """The file as it is, as it would be saved, and what differs."""
        document = self.document
        with document.lock:
            document.check_place()
            text = document.file.read_text(encoding="utf-8")
            name, patch = document.file.name, ops_text(document.ops)
            told: dict[str, Any] = {"file": name, "text": text, "patch": patch, "new_text": "", "diff": ""}
            told["why_not"] = None
            try:
                new = self._new_text(document, text)
                told |= {"new_text": new, "diff": difference(text, new, document.file.name)}
            except GraphError as error:
                told["why_not"] = error_facts(error, (), self.folder)
        return told

    def save(self, body: Mapping[str, Any]) -> Path:
        """Save the edits: in place, as a variant, or as a child file. Raises GraphErrors, Outside, Conflict."""
        document, kind = self.document, body.get("as")
        with document.lock:
            document.check_place()
            judged = document.judged()
            if judged.checked is None and not body.get("faulty"):
                raise GraphErrors(judged.faults)
            if document.changed_on_disk():
                raise Conflict(f"{document.file.name} was changed by somebody else since it was opened",
                               fix="reload it (your edits are kept), then save")  # fmt: skip
            text = document.file.read_text(encoding="utf-8")
            if kind == "file":
                path, new = document.file, self._new_text(document, text)
            elif kind == "variant":
                path = document.file
                new = variant_text(
                    text, path, _variant_name(body.get("name")), document.ops, str(body.get("doc") or "")
                )
            elif kind == "child":
                path = self.places.graph_file(str(body.get("file") or ""), new=True)
                if path.parent.resolve() != document.file.parent.resolve():
                    raise Outside("a file that extends the graph stands beside it", expected=str(document.file.parent))
                if path.exists() and (not body.get("replace") or path.resolve() == document.file.resolve()):
                    raise Conflict(f"{path.name} is there already", fix="choose another name")
                name = str(body.get("name") or path.stem)
                new = child_text(document.file, name, document.base, judged.top, path, document.packs)
            else:
                raise GraphError(f"a graph is saved as file, variant or child, not as {kind!r}")
            write_text(path, new)
            if kind == "child":
                self.open(str(path.relative_to(self.folder)))
            else:
                document.saved()
                if kind == "variant":
                    self.open(str(path.relative_to(self.folder)), str(body["name"]))
        return path

    # --- runs

    def store(self) -> Store:
        """The store, opened anew: what other processes recorded since is in it."""
        with self.session:
            return open_store(self.store_folder, self.shared)

    def start_run(self, body: Mapping[str, Any]) -> str:
        """Start a run of the open graph with its edits; the job's name. Raises GraphErrors where it has faults."""
        document = self.document
        with document.lock:
            judged = document.judged()
            if judged.checked is None:
                raise GraphErrors(judged.faults)
            graph, variant = document.file, ""
            if document.ops and document.ops == self._of_variant(document):
                variant = document.variant
            elif document.ops:
                graph = written_copy(judged.top, document.file, self.store_folder / "studio" / "graphs")
        names = {word: list(body.get(word) or ()) or None for word in ("nodes", "force", "start")}
        selected(judged.checked, **names)  # raises for names that fit nothing
        return self.start_job({
            "kind": "run", "graph": str(graph), "variant": variant, **names,
            "workers": body.get("workers"), "keep_going": bool(body.get("keep_going")), "set": body.get("set") or None,
            "only": None,
        })  # fmt: skip

    def start_job(self, job: Mapping[str, Any]) -> str:
        """Start a run or sweep in a process of its own."""
        return self.jobs.start({"store": str(self.store_folder), "shared": self.shared, **job})

    def run_facts(self, name: str) -> dict[str, Any] | None:
        """RUN of the contract; None where there is no such run."""
        view = self.watcher.view(name)
        if view is None:
            return None
        with self.watcher.lock:
            return {**view.facts(), "ours": name in self.jobs.ours(), "label": self.labels.all().get(name, "")}

    def resume(self, view: RunView) -> str:
        """Run the graph of an earlier run again, as it was set then: what is done are hits. The job's name."""
        record = view.record
        resolved = record.get("resolved") or {}
        known = self.jobs.job(view.id)
        if known is not None and known.get("kind") in ("run", "sweep"):
            return self.start_job(
                {key: value for key, value in known.items() if key not in ("store", "shared", "runs")}
            )
        file = Path(str(record.get("file") or ""))
        if not self.places.holds(file) or str(record.get("command", "")).startswith("exmesh sweep"):
            raise Outside(f"the graph of {view.id} is not in this folder: {file}", expected=f"a file in {self.folder}")
        return self.start_job({
            "kind": "run", "graph": str(file), "variant": str(resolved.get("variant") or ""), "nodes": None,
            "force": None, "start": None, "workers": None, "keep_going": False,
            "set": list(record.get("overrides") or ()) or None,
            "only": None,
        })  # fmt: skip

    def why(self, node: str) -> dict[str, Any]:
        """Why a node of the open graph is a hit or must run, with all that its key depends on."""
        judged = self.document.judged()
        if judged.checked is None:
            raise GraphErrors(judged.faults)
        return why_of(judged.checked, node, self.store()).as_json()

    def node_names(self) -> list[str]:
        """The nodes of the open graph, for messages that belong to one."""
        with self.document.lock:
            return list(self.document.reading(self.document.judged()).entries)

    def session_facts(self) -> dict[str, Any]:
        """What a page should know of the server."""
        return {
            "server": self.server, "version": __version__, "pid": os.getpid(), "clients": len(self.hub.clients),
            "graph": self.document.file.name, "folder": str(self.folder), "run": self.shown_run,
            "machine": {"cpus": os.cpu_count()},
        }  # fmt: skip

    # --- inside

    def _new_text(self, document: Document, text: str) -> str:
        if document.variant:
            return variant_text(text, document.file, document.variant, document.ops)
        return edited_text(text, document.file, document.base, document.judged().top, document.packs)

    def _opened(self, file: Path, variant: str, ops: Sequence[Op]) -> Document:
        document = Document(self.session, self.folder, file, self.store_folder)
        if variant:
            document.variant = variant
        begun = [*(variant_ops(document.base, variant) if variant else ()), *ops]
        document.history, document.begun = [begun], list(begun)
        return document

    def _tell_plan(self, revision: int) -> None:
        self.hub.publish("plan", {"revision": revision})

    def _store_and_code(self) -> Store:
        """The store, with edited code looked at again."""
        self.session.packs()
        return self.store()

    def _look_at_disk(self) -> None:
        """Tell all pages once a file of the open graph was written by somebody else, or is as it was again."""
        document = self.document
        before, now = self._told_disk, (id(document), document.changed_on_disk())
        self._told_disk = now
        if now[1] != (before[1] and before[0] == now[0]):
            self.hub.publish("disk", {"changed": now[1]})

    def _ran(self, ended: bool) -> None:
        """A run finished nodes, or ended."""
        revision = self.document.revision
        later = (lambda: self._tell_plan(revision)) if self.hub.clients else None
        self.planner.ran(self.document.judged(), ended, later)

    def _of_variant(self, document: Document) -> list[Op] | None:
        return variant_ops(document.base, document.variant) if document.variant else None


def _variant_name(name: Any) -> str:
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_][\w.-]{0,79}", name) or name == BASE:
        raise GraphError(f"{name!r} cannot name a variant", expected="letters, digits, _ and -")
    return name


def _as_edit(text: str) -> Op:
    """`--set name=value` as an edit."""
    from exmesh_graph.graph.language.yamlfile import parse_yaml
    from exmesh_graph.studio.values import plain

    name, _, value = str(text).partition("=")
    return {"set": name, "to": plain(parse_yaml(value, None))}
