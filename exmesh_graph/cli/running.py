"""What `exmesh run` and `exmesh sweep` print around a run: warnings, failures, the summary."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import typer

from exmesh_graph.api.board import clock
from exmesh_graph.api.results import Run
from exmesh_graph.cli.options import show_notes
from exmesh_graph.report.differences import named_in_short


@contextlib.contextmanager
def resumable() -> Iterator[None]:
    """Say how to go on after Ctrl-C, and end with code 130."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        run = getattr(interrupt, "run", None)
        if run is None:
            raise
        typer.echo(f"\ninterrupted; go on with the same command:\n  {run.record['command']}", err=True)
        show_notes(run.store)
        raise typer.Exit(130) from None


def show_benchmarks(run: Run) -> None:
    """Print the paper's table of every benchmark that the run scored, and write it as <table>.md into its folder."""
    from exmesh_graph.evaluate.protocols.published import as_markdown, as_text, paper_table
    from exmesh_graph.report.collect import collect_benchmarks

    scored = collect_benchmarks(run.record, run.artifact)
    for name in dict.fromkeys(entry["table"] for entry in scored):
        rows = paper_table(name, [entry for entry in scored if entry["table"] == name])
        (run.folder / f"{name}.md").write_text(as_markdown(rows), encoding="utf-8")
        typer.echo(f"\n{as_text(rows)}\n  {short_path(run.folder / f'{name}.md')}")


def summary(run: Run) -> None:
    """One screen: states, the costly nodes, headline figures, warnings, where the results lie."""
    record, rows = run.record, run.record["nodes"]
    hits = sum(row["state"] == "hit" for row in rows)
    typer.echo(f"\n{record['graph']}: {len(rows)} nodes, {hits} from the store, {len(rows) - hits} run, "
               f"{clock(record['seconds'])}")  # fmt: skip
    if record.get("idle"):
        typer.echo(f"  left out, since nothing needs them: {named_in_short(record['idle'])}")
    slow = sorted((row for row in rows if row["state"] == "done"), key=lambda row: -row["seconds"])[:5]
    if slow and slow[0]["seconds"] >= 0.1:
        typer.echo("  longest: " + ", ".join(f"{row['name']} {clock(row['seconds'])}" for row in slow))
    for name, figure in run.metrics.items() if not run.report_error else ():
        typer.echo(f"  {name}: {figure}")
    for node, text in run.warnings[:5]:
        typer.echo(f"  warning: {node}: {text}")
    if len(run.warnings) > 5:
        typer.echo(f"  ... and {len(run.warnings) - 5} more warnings, all in run.json")
    for name, path in run.paths.items():
        typer.echo(f"  {name}: {short_path(path)}")
    report = run.folder / "report.html"
    typer.echo(f"  report: {short_path(report)}" if report.is_file() else f"  run: {short_path(run.folder)}")


def show_failure(run: Run) -> None:
    """What failed, where the details lie, and how to go on."""
    typer.echo("", err=True)
    for record in run.failures:
        file = short_path(run.folder / record["file"])
        typer.echo(f"failed: {record['node']}: {record['message']}", err=True)
        if record.get("at"):
            typer.echo(f"  at {record['at']}", err=True)
        typer.echo(f"  details: {file}", err=True)
        if record["job"] is not None:
            typer.echo(f"  this node alone, on the same inputs: exmesh replay {file}", err=True)
        typer.echo(f"  this node as the graph is now: {record['replay']}", err=True)
    typer.echo(f"  go on when mended: {run.failures[0]['run_again']}", err=True)


def short_path(path: Path) -> str:
    """Relative to the working folder where it lies below."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
