"""`exmesh status`, `log` and `replay`: what runs do and did, and one failed node again."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from exmesh_graph.errors import ExmeshError


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(status)
    app.command()(log)
    app.command()(replay)


def status(
    runs: Annotated[Path, typer.Option("--runs", help="Where run folders are.")] = Path("runs"),
    last: Annotated[int, typer.Option(help="How many runs.")] = 10,
) -> None:
    """Show the last runs, and what those that go on are doing."""
    from exmesh_graph.cli.show import read_run

    found = sorted((path for path in runs.glob("*/run.json") if not path.parent.is_symlink()), reverse=True)
    if not found:
        typer.echo(f"no runs in {runs}")
    for path in found[:last]:
        try:
            for line in _lines_of(path.parent, read_run(path.parent)):
                typer.echo(line)
        except ExmeshError as error:
            typer.echo(f"{'unreadable':<12}{path.parent.name}  {error.what}")


def log(
    run: Annotated[Path, typer.Argument(help="A run folder.")] = Path("runs/latest"),
    node: Annotated[str | None, typer.Argument(help="One node: its messages and all that it printed.")] = None,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Go on until the run ends.")] = False,
) -> None:
    """Show what happened in a run, or in one of its nodes."""
    from exmesh_graph.graph.run.rundir import is_alive, log_file

    if not (run / "events.jsonl").is_file():
        raise ExmeshError(f"{run} is no run folder", fix="exmesh status lists the runs")
    run = run.resolve()
    events, printed = _Tail(run / "events.jsonl"), _Tail(log_file(run, node)) if node else None
    known = set(json.loads((run / "run.json").read_text(encoding="utf-8"))["resolved"]["nodes"])
    if node is not None and node not in known:
        from exmesh_graph.graph.problems import nearest

        raise ExmeshError(
            f"the run has no node {node!r}", expected=", ".join(nearest(node, known) or sorted(known)[:8])
        )
    while True:
        alive = follow and is_alive(run)  # asked first: what it wrote last is read below
        for line in events.lines():
            shown = _event_line(line, node)
            if shown:
                typer.echo(shown)
        for line in printed.lines() if printed else ():
            typer.echo(f"          | {line}")
        if not alive:
            return
        time.sleep(0.3)


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="runs/ID/failures/NODE.json of a failed node.")],
    store: Annotated[Path | None, typer.Option("--store", help="The store (default: the one of that run).")] = None,
) -> None:
    """Run one failed node again, with the code as it is now, on the very inputs it had; the result is recorded."""
    import faulthandler

    from exmesh_graph.api.progress import Plain
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.declare.packs import Packs
    from exmesh_graph.graph.run.job import BROKEN, DONE, Job, execute, rekeyed
    from exmesh_graph.graph.run.memory import Memory

    faulthandler.enable(2)
    job = Job.from_json(_job_in(file))
    opened = Store(store or Path(job.store))
    packs = Packs(job.packs or None).load()
    with packs:
        job = rekeyed(job, opened)
    view = Plain({job.name: job.type})

    def emit(event: Mapping[str, Any]) -> None:
        stamped = {"time": time.time(), **event}
        view.listen(stamped)
        if event["event"] == "log":
            typer.echo(f"          {event['message']}")

    emit({"event": "run_started", "nodes": [job.name]})
    emit({"event": "node_started", "node": job.name})
    with packs:
        outcome = execute(job, opened, Memory(), emit)
    if outcome.state == BROKEN:
        wire = job.wires[outcome.info["port"]]
        raise ExmeshError(
            f"the input {wire} is no longer in the store", where=str(opened.root), fix="run the graph again"
        )
    if outcome.state != DONE:
        typer.echo(outcome.info["traceback"], err=True)
        typer.echo(f"failed again: {job.name}: {outcome.info['message']}", err=True)
        raise typer.Exit(1)
    typer.echo(f"{job.name} is done in {outcome.info['seconds']:.2f} s; a run of the graph will find its result")


def _lines_of(run: Path, record: Mapping[str, Any]) -> Iterator[str]:
    """A run's state in one line, and a line for each node that runs or stopped it."""
    from exmesh_graph.api.board import board_of, clock
    from exmesh_graph.graph.run.rundir import is_alive

    board = None
    state, states = record["state"], {row["name"]: row["state"] for row in record["nodes"]}
    now = time.time()
    if state == "unfinished":  # run.json lags behind the events
        state = "running" if is_alive(run) else "killed"
        with contextlib.suppress(OSError, KeyError, TypeError):
            board = board_of(run)
            states = {**states, **board.states}
            now = now if state == "running" else board.last
    ready = sum(each in ("hit", "done") for each in states.values())
    hits = sum(each == "hit" for each in states.values())
    spent = clock(record["seconds"] if "seconds" in record else max(0.0, now - record["started"]))
    left = board.left(now) if board and state == "running" else None
    about = "" if left is None else f", about {clock(left)} left"
    yield f"{state:<12}{record['id']}  {ready}/{len(states)} nodes, {hits} hits, {spent}{about}"
    if state == "running" and board:
        for name, busy in board.running.items():
            yield f"{'':<12}{name}  {busy.text(now)}"
        return
    busy_ones = [name for name, each in states.items() if each in ("running", "failed", "interrupted")]
    if busy_ones and state != "done":
        yield f"{'':<12}at {', '.join(busy_ones)}"


def _event_line(line: str, node: str | None) -> str:
    """A line of events.jsonl in words; empty for what is not shown."""
    from exmesh_graph.api.board import RunningNode, clock, event_of

    event = event_of(line)
    if event is None or (node is not None and event.get("node") != node):
        return ""
    kind, where = event["event"], "" if node else f"{event.get('node', '')}  "
    spent = clock(float(event.get("seconds", 0.0))) if kind in ("run_finished", "node_finished") else ""
    words = {
        "run_started": lambda: f"run {event['run']}, {len(event['nodes'])} nodes",
        "run_finished": lambda: f"{event['state']} after {spent}",
        "node_started": lambda: f"{where}starts",
        "node_finished": lambda: f"{where}{event['state']}" + (f"  {spent}" if event["state"] == "done" else ""),
        "node_failed": lambda: f"{where}failed: {event['message']}",
        "node_blocked": lambda: f"{where}blocked: needs what failed",
        "log": lambda: where + event["message"],
        "warning": lambda: f"{where}warning: {event['message']}",
        "stopping": lambda: f"asked to stop; running: {', '.join(event['nodes']) or 'nothing'}",
        "progress": lambda: RunningNode(event["time"], event).text(event["time"]),
    }  # fmt: skip
    if kind not in words or (kind == "progress" and node is None):
        return ""
    return f"{time.strftime('%H:%M:%S', time.localtime(event['time']))}  {words[kind]()}"


class _Tail:
    """The whole lines that a growing file has gained since the last look."""

    def __init__(self, path: Path) -> None:
        self.path, self.place, self.rest = path, 0, b""

    def lines(self) -> list[str]:
        with contextlib.suppress(FileNotFoundError), self.path.open("rb") as file:
            file.seek(self.place)
            data = file.read()
            self.place += len(data)
            *whole, self.rest = (self.rest + data).split(b"\n")
            return [line.decode(errors="replace") for line in whole]
        return []


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
