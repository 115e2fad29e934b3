"""`exmesh status`, `log`, `prov` and `replay`: what runs do and did, and one failed node again."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exmesh_graph.cli.options import AsJson, put_json
from exmesh_graph.errors import ExmeshError

if TYPE_CHECKING:
    from exmesh_graph.api.watch import RunStatus


def status(
    runs: Annotated[Path, typer.Option("--runs", help="Where run folders are.")] = Path("runs"),
    last: Annotated[int, typer.Option(help="How many runs.")] = 10,
    as_json: AsJson = False,
) -> None:
    """Show the last runs, and what those that go on are doing."""
    from exmesh_graph.api import watch

    runs_now, now = watch.statuses(runs, last), time.time()
    if as_json:
        put_json({"schema": watch.SCHEMA, "runs": [run.as_json(now) for run in runs_now]})
        return
    if not runs_now:
        typer.echo(f"no runs in {runs}")
    for run in runs_now:
        for line in _lines_of(run, now):
            typer.echo(line)


def log(
    run: Annotated[Path, typer.Argument(help="A run folder.")] = Path("runs/latest"),
    node: Annotated[str | None, typer.Argument(help="One node: its messages and all that it printed.")] = None,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Go on until the run ends.")] = False,
) -> None:
    """Show what happened in a run, or in one of its nodes."""
    from exmesh_graph.api import watch

    for kind, line in watch.follow(run, node, follow):
        shown = f"          | {line}" if kind == "printed" else _event_line(line, node)
        if shown:
            typer.echo(shown)


def prov(
    run: Annotated[Path, typer.Argument(help="A run folder.")] = Path("runs/latest"),
    out: Annotated[Path | None, typer.Option("-o", "--out", help="FILE.json, .jsonld or .provn; else printed.")] = None,
    store: Annotated[Path | None, typer.Option("--store", help="The store (default: the one of that run).")] = None,
) -> None:
    """Say where everything of a run comes from, as W3C PROV."""
    from exmesh_graph.api.prov_export import FORMATS, prov_text
    from exmesh_graph.api.runs import open_run

    kind = FORMATS.get(".json" if out is None else out.suffix)
    if kind is None:
        raise ExmeshError(f"PROV is not written as {out}", expected="a name in " + ", ".join(FORMATS))
    text = prov_text(open_run(run, store=store), kind)
    if out is None:
        typer.echo(text)
    else:
        out.write_text(text + "\n", encoding="utf-8")
        typer.echo(str(out))


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="runs/ID/failures/NODE.json of a failed node.")],
    store: Annotated[Path | None, typer.Option("--store", help="The store (default: the one of that run).")] = None,
) -> None:
    """Run one failed node again, with the code as it is now, on the very inputs it had; the result is recorded."""
    from exmesh_graph.api import watch
    from exmesh_graph.api.progress import Plain

    def view(job: Any) -> Any:
        lines = Plain({job.name: job.type})

        def listen(event: Any) -> None:
            lines.listen(event)
            if event["event"] == "log":
                typer.echo(f"          {event['message']}")

        return listen

    outcome = watch.replay(file, store, view)
    if outcome.state != "done":
        typer.echo(outcome.info["traceback"], err=True)
        typer.echo(f"failed again: {outcome.name}: {outcome.info['message']}", err=True)
        raise typer.Exit(1)
    typer.echo(f"{outcome.name} is done in {outcome.info['seconds']:.2f} s; a run of the graph will find its result")


def _lines_of(run: RunStatus, now: float) -> Iterator[str]:
    """A run's state in one line, and a line for each node that runs or stopped it."""
    from exmesh_graph.api.board import clock

    if run.state == "unreadable":
        yield f"{run.state:<12}{run.id}  {run.reason}"
        return
    about = "" if run.left is None else f", about {clock(run.left)} left"
    yield f"{run.state:<12}{run.id}  {run.ready}/{run.nodes} nodes, {run.hits} hits, {clock(run.seconds)}{about}"
    for name, active in run.running:
        yield f"{'':<12}{name}  {active.text(now)}"
    if run.at and run.state not in ("done", "running"):
        yield f"{'':<12}at {', '.join(run.at)}"


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
