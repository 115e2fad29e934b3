"""Running a graph from Python: `run`, `open_run`, and what a failed run raises."""

from __future__ import annotations

import contextlib
import os
import shlex
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from exmesh_graph.api.arguments import checked_options, path_of
from exmesh_graph.api.builder import Graph
from exmesh_graph.api.opening import (
    Folder,
    Names,
    Settings,
    Source,
    checked_graph,
    open_store,
    packs,
    texts_of,
    using,
)
from exmesh_graph.api.progress import Progress, finished, listening
from exmesh_graph.api.provenance import provenance, sign_assets
from exmesh_graph.api.results import Run, read_failures, read_run
from exmesh_graph.api.selecting import matching, selected
from exmesh_graph.errors import GraphError
from exmesh_graph.files import writing
from exmesh_graph.graph.run.runner import Listener, NodeFailed

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.language.check import Checked
    from exmesh_graph.graph.run.backends import Backend
    from exmesh_graph.graph.session import Session


class RunFailed(NodeFailed):
    """A run in which nodes failed; `run` is what came of the others, `records` what the failure files hold.

    `local`: the graph has node types of a script or notebook, which no command knows.
    """

    def __init__(self, run: Run, records: list[Mapping[str, Any]], cause: BaseException | None, place: str,
                 *, local: bool = False) -> None:  # fmt: skip
        super().__init__(records, cause)
        self.run, self.folder = run, run.folder
        self.where = f"{self.node} ({place})" if place else self.node
        self.expected = ""
        others = f"; {len(records) - 1} more failed: " + ", ".join(str(r["node"]) for r in records[1:6])
        self.what = str(self.record["message"]) + (others if len(records) > 1 else "")
        again = "mend it and run again, what is done is kept"
        self.fix = f"{again}, from here" if local else f"{again}: {self.record['run_again']}"

    def __str__(self) -> str:
        at = f"\n  at {self.record['at']}" if self.record.get("at") else ""
        details = f"\n  folder: {self.folder}\n  details: {self.folder / self.record['file']}"
        return f"{self.where}: {self.what}{at}{details}\n  fix: {self.fix}"


def run(
    graph: Source,
    *,
    set: Settings = None,
    variant: str | None = None,
    nodes: Names = None,
    force: Names = None,
    start: Names = None,
    store: Folder = None,
    shared: str | None = None,
    runs: str | os.PathLike[str] = "runs",
    workers: int | None = None,
    backend: str = "local",
    address: str | None = None,
    tokens: Mapping[str, float] | str | None = None,
    keep_going: bool = False,
    progress: Progress = "auto",
    listener: Listener | None = None,
    report: bool = True,
    session: Session | None = None,
    **params: Any,
) -> Run:
    """Run a graph: a file, or one built in Python. What is in the store is not run again, so the same call resumes.

    set       settings as `--set` takes them: {"pbr.iterations": 800, "rounds.repeat": 2}
    params    graph parameters: scene="my_scene", faces=20_000
    nodes     run only what these need; force: run these even on a hit; start: run these and all below them even then.
              `*` stands for anything ("look*"), a name without rounds for all rounds of a node ("rounds.refine")
    workers   worker processes at most, None: what the machine can take; 0: all nodes in this process
    backend   local or ray (address: its cluster); tokens: what nodes may use together, {"cpu": 4} or "cpu=4"
    progress  "auto": shown on a terminal and in a notebook; True: always; False: never
    listener  called with every event of the run, a mapping with `event`, `time` and mostly `node`
    Raises GraphErrors with all faults before anything runs, RunFailed when nodes fail, KeyboardInterrupt (its `run`
    holds what was done) when it is interrupted; the same call then goes on.
    """
    checked_options(workers, tokens, progress, listener)
    runs = path_of(runs, "runs", "the path of a folder")
    with using(session):
        checked = checked_graph(graph, set, variant, store, **params)
        at = Resources(store, shared, runs, workers, backend, address, tokens_of(tokens))
        chosen = selected(checked, nodes, force, start)
        sets = texts_of(set, params)
        words = [*command_words(sets, {"--variant": variant}), *at.words(), *(["--keep-going"] if keep_going else [])]
        only = [word for name in matching(chosen.graph, nodes) for word in ("--node", name)]
        return run_checked(
            chosen.graph, [graph], at, words, progress=progress, listener=listener, report=report, only=only,
            targets=chosen.targets, force=chosen.force, overrides=tuple(sets), keep_going=keep_going,
        )  # fmt: skip


class Resources(NamedTuple):
    """Store, run folders, backend and tokens of a run: what `run` and `sweep` take by these names."""

    store: Folder
    shared: str | None
    runs: Path
    workers: int | None
    backend: str
    address: str | None
    tokens: Mapping[str, float]

    def words(self) -> list[str]:
        """How a command names them; what is as by default is left out."""
        options = {
            "--store": self.store, "--shared": self.shared, "--runs": None if self.runs == Path("runs") else self.runs,
            "--workers": self.workers,
            "--tokens": ",".join(f"{name}={count:g}" for name, count in self.tokens.items()) or None,
            "--backend": None if self.backend == "local" else self.backend, "--address": self.address,
        }  # fmt: skip
        return command_words((), options)


def run_checked(
    checked: Checked,
    sources: Sequence[Source],
    at: Resources,
    words: list[str],
    *,
    progress: Progress,
    listener: Listener | None,
    report: bool,
    only: Sequence[str] = (),
    verb: str = "run",
    **options: Any,
) -> Run:
    """Run a checked graph in a new run folder; `words` and `only` of a command would run it again."""
    from exmesh_graph.graph.cache.store import writable
    from exmesh_graph.graph.run.rundir import RunFolder
    from exmesh_graph.graph.run.runner import Runner

    for module, why in packs().broken.items():
        warnings.warn(f"the node module {module} cannot be imported: {why}", stacklevel=3)
    store = open_store(at.store, at.shared)
    with contextlib.ExitStack() as layer:
        opened = layer.enter_context(writable(store))
        backend = backend_of(at.workers, opened, at.backend, at.address)
        folder = RunFolder(at.runs, checked.name)
        files = _files(sources, folder.path)
        command = ["exmesh", verb, *files, *words]
        checked = replace(checked, file=Path(files[0]).absolute())
        with contextlib.closing(folder), listening(progress, listener, checked, folder.id) as listen:
            work = Runner(checked, opened, folder, listen, backend=backend, command=shlex.join([*command, *only]),
                          alone=shlex.join(command), tokens=at.tokens, **options)  # fmt: skip
            work.record["provenance"] = provenance(checked, work.record["command"])
            result = Run(folder.path, work.record, opened)
            if opened is not store:  # a temporary one, needed as long as the handle
                result.keep(layer.pop_all().close)
            try:
                work.run()
            except NodeFailed as failure:
                result.failures = failure.records
                place = checked.node(failure.node).where
                local = any(bound.definition.function.__module__ == "__main__" for bound in checked.nodes.values())
                raise RunFailed(result, failure.records, failure.cause, str(place), local=local) from failure.cause
            except KeyboardInterrupt as interrupt:
                interrupt.run = result  # type: ignore[attr-defined]
                raise
            finally:
                with writing("the run folder", folder.path, "--runs"):
                    sign_assets(folder.path, work.record)  # a published copy goes its own way
    if report:
        try:
            result.make_report()
        except Exception as error:
            result.report_error = f"{type(error).__name__}: {error}"
            warnings.warn(f"all nodes are done, but the report failed: {result.report_error}", stacklevel=3)
    finished(result)
    return result


def _files(sources: Sequence[Source], folder: Path) -> list[str]:
    """The files of graphs; those built in Python are written into the run folder, so that commands can name them."""
    files = []
    for source in sources:
        if isinstance(source, Graph):
            path = folder / ("graph.yaml" if len(sources) == 1 else f"{source.name}.yaml")
            source.to_yaml(path)
            files.append(str(path))
        else:
            files.append(str(source))
    return files


def open_run(
    folder: str | os.PathLike[str] = "runs/latest", *, store: Folder = None, session: Session | None = None
) -> Run:
    """The handle of an earlier run, or of one that goes on. Raises ExmeshError where there is none."""
    path = path_of(folder, "the folder of a run", fix="ex.open_run() opens the latest run")
    record = read_run(path)
    with using(session):
        packs()  # for the wire types that they define
        used = record.get("store") if store is None else store
        known = used if used and Path(used).is_dir() else store
        opened = Run(path.resolve(), record, open_store(known))
        opened.failures = read_failures(opened.folder, record)
        return opened


def backend_of(workers: int | None, store: Store, kind: str = "local", address: str | None = None) -> Backend:
    """local: this process for 0 workers, else worker processes, as many as the machine can take for None; or ray."""
    if kind == "ray":
        from exmesh_graph.graph.run.backends.ray import RayCluster

        return RayCluster(store, address)
    if kind != "local":
        raise GraphError(f"there is no backend {kind!r}", expected="local or ray")
    from exmesh_graph.graph.run.backends import Inline
    from exmesh_graph.graph.run.backends.local import Local

    return Inline(store) if workers == 0 else Local(workers)


def tokens_of(tokens: Mapping[str, float] | str | None) -> Mapping[str, float]:
    """Tokens as a mapping; a text is what --tokens takes."""
    return parse_tokens(tokens) if isinstance(tokens, str) else dict(tokens or {})


def command_words(sets: Iterable[str], options: Mapping[str, Any], flags: Iterable[str] = ()) -> list[str]:
    """The words of a command after its graph; options without a value are left out."""
    words = [word for text in sets for word in ("--set", text)]
    words += [str(word) for option, value in options.items() if value is not None for word in (option, value)]
    return [*words, *flags]


def parse_tokens(text: str) -> dict[str, float]:
    """`cpu=4,gpu=1` of the command line. Raises GraphError."""
    tokens: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        name, equals, value = part.partition("=")
        try:
            tokens[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals or not name.strip() or not 0 <= tokens[name.strip()] < float("inf"):
            raise GraphError(f"cannot read --tokens {text!r}", where="command line", expected="cpu=4,gpu=1,ram_gb=16")
    return tokens
