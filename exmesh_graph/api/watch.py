"""Looking at runs from outside: their states while they go on, what they print, and one failed node again."""

from __future__ import annotations

import contextlib
import faulthandler
import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from exmesh_graph.api.board import RunningNode, board_of
from exmesh_graph.api.opening import Folder
from exmesh_graph.api.results import read_run
from exmesh_graph.errors import ExmeshError
from exmesh_graph.files import Tail
from exmesh_graph.graph.cache.keys import ABSENT, Stored
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.problems import nearest
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import BROKEN, Job, Outcome
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.graph.run.plan import preimage_for
from exmesh_graph.graph.run.rundir import is_alive, log_file

SCHEMA = "exmesh.status.v1"


@dataclass(frozen=True)
class RunStatus:
    """A run as it is now: `ready` of `nodes` nodes have results, `hits` of them from the store.

    state    done, failed, interrupted, running, killed, or unreadable (then `reason` says why)
    seconds  since its start, or in all; left: to the end as earlier runs took, None where that cannot be said
    running  the nodes at work; at: those that run, failed or were interrupted
    """

    id: str
    folder: str
    state: str
    nodes: int = 0
    ready: int = 0
    hits: int = 0
    seconds: float = 0.0
    left: float | None = None
    running: tuple[tuple[str, RunningNode], ...] = ()
    at: tuple[str, ...] = ()
    reason: str = ""

    def as_json(self, now: float) -> dict[str, Any]:
        """What `exmesh status --json` writes of it."""
        told = {
            name: {"seconds": now - node.began, "step": node.progress.get("step"), "total": node.progress.get("total"),
                   "left": node.left(now)}
            for name, node in self.running
        }  # fmt: skip
        return {**asdict(self), "running": told, "at": list(self.at)}


def statuses(runs: Folder = "runs", last: int = 10) -> list[RunStatus]:
    """The last runs of a folder, the newest first."""
    paths = sorted((p for p in Path(runs or "runs").glob("*/run.json") if not p.parent.is_symlink()), reverse=True)
    return [_status(path.parent) for path in paths[:last]]


def _status(run: Path) -> RunStatus:
    try:
        record = read_run(run)
    except ExmeshError as error:
        return RunStatus(run.name, str(run), "unreadable", reason=error.what)
    board = None
    state, states = record["state"], {row["name"]: row["state"] for row in record["nodes"]}
    now = time.time()
    if state == "unfinished":  # run.json lags behind the events
        state = "running" if is_alive(run) else "killed"
        with contextlib.suppress(OSError, KeyError, TypeError):
            board = board_of(run)
            states = {**states, **board.states}
            now = now if state == "running" else board.last
    running = tuple(board.running.items()) if board is not None and state == "running" else ()
    return RunStatus(
        record["id"],
        str(run),
        state,
        len(states),
        sum(each in ("hit", "done", "idle") for each in states.values()),
        sum(each == "hit" for each in states.values()),
        record["seconds"] if "seconds" in record else max(0.0, now - record["started"]),
        board.left(now) if board is not None and state == "running" else None,
        running,
        tuple(name for name, each in states.items() if each in ("running", "failed", "interrupted")),
    )


def follow(run: Folder = "runs/latest", node: str | None = None, wait: bool = False) -> Iterator[tuple[str, str]]:
    """("event" or "printed", line) of a run, or of one of its nodes; with `wait` until it ends. Raises ExmeshError."""
    folder = Path(run or "runs/latest")
    if not (folder / "events.jsonl").is_file():
        raise ExmeshError(f"{folder} is no run folder", fix="exmesh status lists the runs")
    folder = folder.resolve()
    events, printed = Tail(folder / "events.jsonl"), Tail(log_file(folder, node)) if node else None
    known = list(json.loads((folder / "run.json").read_text(encoding="utf-8"))["resolved"]["nodes"])
    if node is not None and node not in known:
        near = ", ".join(nearest(node, known) or sorted(known)[:8])
        raise ExmeshError(f"the run has no node {node!r}", expected=near)
    while True:
        alive = wait and is_alive(folder)  # asked first: what it wrote last is read below
        for line in events.lines():
            yield "event", line
        for line in printed.lines() if printed else ():
            yield "printed", line
        if not alive:
            return
        time.sleep(0.3)


def replay(file: Path, store: Folder = None, view: Callable[[Job], Callable[[Any], None]] | None = None) -> Outcome:
    """Run one failed node again, with the code as it is now, on the inputs it had; `file` is its failure file.

    `view` makes a listener for the events. Raises ExmeshError where the file or an input cannot be used.
    """
    faulthandler.enable(2)
    job = Job.from_json(_job_in(file))
    opened = Store(Path(store or job.store))
    packs = Packs(job.packs or None).load()
    with packs:
        job = _rekeyed(job, opened)
    listen = view(job) if view else lambda event: None

    def emit(event: Mapping[str, Any]) -> None:
        listen({"time": time.time(), **event})

    emit({"event": "run_started", "nodes": [job.name]})
    emit({"event": "node_started", "node": job.name})
    with packs:
        outcome = execute(job, opened, Memory(), emit)
    if outcome.state == BROKEN:
        wire = job.wires[outcome.info["port"]]
        what, fix = f"the input {wire} is no longer in the store", "run the graph again"
        raise ExmeshError(what, where=str(opened.root), fix=fix)
    return outcome


def _job_in(file: Path) -> Mapping[str, Any]:
    """The job that a failure file holds."""
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        job = record["job"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"this is no failure file: {type(error).__name__}: {error}"
        raise ExmeshError(what, where=str(file), fix="name runs/ID/failures/NODE.json") from error
    if not isinstance(job, dict):
        raise ExmeshError(f"{record['node']} failed before it could start", where=str(file), fix=record["run_again"])
    return job


def _rekeyed(job: Job, store: Store) -> Job:
    """The job with the key that it has now, on `store`: code, libraries or source files may have changed since."""
    bound = job.bound()
    known: dict[str, dict[str, Stored]] = {}
    for port, link in bound.inputs.items():
        kind, digest = job.inputs.get(port, ABSENT)
        known.setdefault(link.node, {})[link.port] = Stored(kind, digest, 0)
    preimage = preimage_for(bound, store, known)
    return replace(job, preimage=preimage, store=str(store.root))
