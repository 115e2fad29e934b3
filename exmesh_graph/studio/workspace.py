"""What a server has open: one graph with its edits, the store, the runs, and the pages that look on."""

from __future__ import annotations

import itertools
import os
import re
import secrets
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from pathlib import Path
from typing import Any

from exmesh_graph.api.opening import open_store
from exmesh_graph.api.planning import why_of
from exmesh_graph.api.results import read_run
from exmesh_graph.api.selecting import selected
from exmesh_graph.errors import ExmeshError, GraphError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.files import writing
from exmesh_graph.graph.problems import GraphErrors
from exmesh_graph.graph.session import current_session, store_folder
from exmesh_graph.graph.variants.declared import BASE
from exmesh_graph.studio.artifacts.shelf import Shelf
from exmesh_graph.studio.copies import written_copy
from exmesh_graph.studio.document import Document, Judged, variant_ops
from exmesh_graph.studio.edits import Op
from exmesh_graph.studio.faults import error_facts
from exmesh_graph.studio.hub import Hub
from exmesh_graph.studio.jobs import Jobs
from exmesh_graph.studio.labels import Labels
from exmesh_graph.studio.listing import graph_file_facts
from exmesh_graph.studio.plans import plan_facts
from exmesh_graph.studio.runview import RunView
from exmesh_graph.studio.saving import child_text, difference, edited_text, ops_text, variant_text
from exmesh_graph.studio.watching import Watcher
from exmesh_graph.version import __version__

PLAN_WAIT = 0.4
"""Seconds that an answer waits for its plan; a later one is told of by the event `plan`."""
PLAN_EVERY = 5.0
"""Seconds at least between two plans while a run goes on."""


class Outside(ExmeshError):
    """A path that leads out of the graph's folder, or to no graph file there."""

    code = "unknown"


class Conflict(ExmeshError):
    """A request that does not fit the state of the server or of the disk."""

    code = "conflict"


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
        self.watcher = Watcher(self.runs, self.hub.publish, self._ran)
        self.labels = Labels(self.store_folder / "studio" / "labels.json")
        self.shelf = Shelf(self.store)
        self._work = ThreadPoolExecutor(1, "studio-plan")
        self._plan: tuple[Judged, int, Future[dict[str, Any]]] | None = None
        self._again_after = 0.0
        self._ticks = 0  # grows when runs may have changed the plan
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
        """Begin to follow the runs."""
        self.jobs.sweep()
        self.watcher.start()

    def close(self) -> None:
        self.hub.close()
        self.watcher.close()
        self._work.shutdown(wait=False, cancel_futures=True)

    # --- the document

    def facts(self, ops: Sequence[Op] | None = None, wait: float = PLAN_WAIT) -> dict[str, Any]:
        """DOCUMENT of the contract, with its plan where that is ready in time."""
        document = self.document
        with document.lock:
            judged = document.judged(ops)
            told = document.facts(ops)
        told |= {"store": str(self.store_folder), "runs": str(self.runs), "run": self.shown_run, "plan": None,
                 "plan_pending": False}  # fmt: skip
        if judged.checked is not None:
            if ops is None:
                work = self._planning(document, judged)
                try:
                    told["plan"] = work.result(wait)
                except NotYet:
                    told["plan_pending"] = True
                    work.add_done_callback(lambda done: self._tell_plan(document.revision))
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
        return self._planning(document, judged).result()

    def open(self, name: str, variant: str = "") -> None:
        """Open another graph file of the folder. Raises Outside, GraphErrors."""
        file = self.graph_file(name)
        document = self._opened(file, variant, ())
        with self.lock:
            document.revision = self.document.revision + 1
            self.document = document

    def graph_file(self, name: str, *, new: bool = False) -> Path:
        """A graph file in the folder, or with `new` the place for one. Raises Outside."""
        given = str(name)
        path = self.folder / given
        if not given or "\0" in given or len(given) > 500 or path.suffix not in (".yaml", ".yml"):
            raise Outside(f"{given!r} names no graph file", expected="a .yaml file in the graph's folder")
        real = Path(os.path.realpath(path))
        if not real.is_relative_to(os.path.realpath(self.folder)):
            raise Outside(f"{given!r} lies outside of the graph's folder", expected=f"a file in {self.folder}")
        if new:
            if not real.parent.is_dir():
                raise Outside(f"there is no folder for {given!r}", expected=f"a file in {self.folder}")
        elif not real.is_file():
            raise Outside(f"there is no graph file {given!r}", expected="GET /api/graphs lists them")
        return path

    def changed(self, what: str, by: str = "") -> None:
        """Tell all pages that the document changed."""
        self.hub.publish("document", {"revision": self.document.revision, "by": by, "what": what})

    def text(self) -> dict[str, Any]:
        """The file as it is, as it would be saved, and what differs."""
        document = self.document
        with document.lock:
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
                path = self.graph_file(str(body.get("file") or ""), new=True)
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
        if not self._is_own(file) or str(record.get("command", "")).startswith("exmesh sweep"):
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

    def graphs(self) -> list[dict[str, Any]]:
        """The graph files of the folder and of folders in it."""
        found = []
        for path in sorted(itertools.islice(self.folder.glob("**/*.yaml"), 2000)):
            parts = path.relative_to(self.folder).parts
            if len(parts) <= 3 and not any(part.startswith(".") for part in parts) and self._is_own(path):
                told = graph_file_facts(path)
                if told is not None:
                    found.append({"file": str(Path(*parts)), **told})
        return found[:500]

    def lights(self) -> list[str]:
        """Pictures of light in the graph's folder."""
        found = itertools.islice((p for p in self.folder.glob("**/*") if p.suffix in (".exr", ".hdr")), 200)
        return sorted(str(path.relative_to(self.folder)) for path in found if self._inside(path))

    def light(self, name: str) -> Any:
        """The light in a file of the graph's folder, canonical lat-long. Raises Outside, DataError."""
        from exmesh_graph.io.envmaps import read_environment

        path = self.folder / name
        if "\0" in name or path.suffix not in (".exr", ".hdr") or not path.is_file() or not self._inside(path):
            raise Outside(f"there is no light {name[:80]!r}", expected="GET /api/lights lists them")
        return read_environment(path)

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

    def _inside(self, path: Path) -> bool:
        return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(self.folder))

    def _is_own(self, file: Path) -> bool:
        """Whether a graph file is in the graph's folder, or one that the page wrote into the store."""
        real = Path(os.path.realpath(file))
        homes = (self.folder, self.store_folder / "studio" / "graphs", self.runs)
        return real.is_file() and any(real.is_relative_to(os.path.realpath(home)) for home in homes)

    def _opened(self, file: Path, variant: str, ops: Sequence[Op]) -> Document:
        document = Document(self.session, self.folder, file, self.store_folder)
        if variant:
            document.variant = variant
        begun = [*(variant_ops(document.base, variant) if variant else ()), *ops]
        document.history, document.begun = [begun], list(begun)
        return document

    def _of_variant(self, document: Document) -> list[Op] | None:
        return variant_ops(document.base, document.variant) if document.variant else None

    def _planning(self, document: Document, judged: Judged) -> Future[dict[str, Any]]:
        """The plan that is being made of a graph, or was."""
        with self.lock:
            known = self._plan
            if known is None or known[0] is not judged or known[1] != self._ticks:
                known = self._plan = judged, self._ticks, self._work.submit(self._planned, judged)
            return known[2]

    def _planned(self, judged: Judged) -> dict[str, Any]:
        assert judged.checked is not None
        return plan_facts(judged.checked, self.store())

    def _tell_plan(self, revision: int) -> None:
        self.hub.publish("plan", {"revision": revision})

    def _ran(self, ended: bool) -> None:
        """A run finished nodes, or ended: what is planned may be another now.

        While runs go on this costs them at most a fiftieth: plans are made again after a while only.
        """
        if not ended and time.monotonic() < self._again_after:
            return
        self._ticks += 1
        judged = self.document.judged()
        if judged.checked is not None and self.hub.clients:
            revision, began = self.document.revision, time.monotonic()

            def done(work: Future[dict[str, Any]]) -> None:
                self._again_after = time.monotonic() + max(PLAN_EVERY, 50 * (time.monotonic() - began))
                self._tell_plan(revision)

            self._again_after = began + 600
            self._planning(self.document, judged).add_done_callback(done)


def _variant_name(name: Any) -> str:
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_][\w.-]{0,79}", name) or name == BASE:
        raise GraphError(f"{name!r} cannot name a variant", expected="letters, digits, _ and -")
    return name


def write_text(path: Path, text: str) -> None:
    """Replace a file in one step; its mode is kept, and where it is a link, what that leads to is replaced."""
    real = Path(os.path.realpath(path))
    draft = real.with_name(f".{real.name}.{os.getpid()}.draft")
    with writing("the graph file", real, "another name"):
        draft.write_text(text, encoding="utf-8")
        if real.exists():
            os.chmod(draft, real.stat().st_mode & 0o7777)
        os.replace(draft, real)


def _as_edit(text: str) -> Op:
    """`--set name=value` as an edit."""
    from exmesh_graph.graph.language.yamlfile import parse_yaml
    from exmesh_graph.studio.values import plain

    name, _, value = str(text).partition("=")
    return {"set": name, "to": plain(parse_yaml(value, None))}
