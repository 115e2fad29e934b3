"""Commands for rewired graphs and their pictures: `exmesh sweep`, `exmesh diff`, `exmesh show`."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exmesh_graph.cli import options

if TYPE_CHECKING:
    from exmesh_graph.report.drawing.svg import GraphPicture

PictureFile = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FILE", help="A picture: FILE.svg, FILE.html or FILE.mmd.")
]
Rounds = Annotated[bool, typer.Option("--rounds", help="Draw every round of repeat blocks.")]


def sweep(
    graphs: Annotated[list[Path], typer.Argument(metavar="GRAPH...", help="Graph files that declare variants.")],
    set_: options.Sets = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="VARIANT", help="This variant and the base; repeatable.")
    ] = None,
    node: options.Targets = None,
    plan: Annotated[bool, typer.Option("--plan", help="Only say what would run.")] = False,
    keep_going: Annotated[
        bool, typer.Option("--keep-going/--stop", help="After a failure run what does not need it.")
    ] = True,
    workers: Annotated[
        int | None, typer.Option("--workers", "--jobs", min=0, help="Worker processes at most; 0: this process.")
    ] = None,
    tokens: Annotated[str, typer.Option(metavar="cpu=4,gpu=1", help="What nodes may use together.")] = "",
    store: options.StoreFolder = None,
    shared: options.SharedUrl = None,
    runs: options.RunsFolder = Path("runs"),
    backend: options.BackendChoice = options.BackendName.local,
    address: options.RayAddress = None,
) -> None:
    """Run a graph and all variants it declares, equal nodes once, and compare them in one table."""
    from exmesh_graph.api.opening import open_store
    from exmesh_graph.api.sweeps import Study
    from exmesh_graph.api.sweeps import sweep as run_sweep
    from exmesh_graph.cli.running import resumable, short_path, show_benchmarks

    if plan:
        study = Study.of(graphs, set_ or [], only, node or (), store)
        typer.echo(str(study))
        for line in study.plan(open_store(store, shared)):
            typer.echo(line)
        return
    with resumable():
        done = run_sweep(
            *graphs, set=set_, only=only, nodes=node, store=store, shared=shared, runs=runs, workers=workers,
            backend=backend.value, address=address, tokens=tokens, keep_going=keep_going, progress=True,
            started=lambda study: typer.echo(str(study)),
        )  # fmt: skip
    options.show_notes(done.run.store)
    show_table(done.table)
    show_benchmarks(done.run)
    for record in [record for record in done.run.failures if record["job"] is not None][:5]:
        typer.echo(
            f"  {record['node']} alone, on the same inputs: exmesh replay {short_path(done.folder / record['file'])}"
        )
    typer.echo(f"  {short_path(done.page)}")
    raise typer.Exit(1 if done.failures else 0)


def diff(
    old: Annotated[Path, typer.Argument(metavar="OLD", help="A graph file or a run folder.")],
    new: Annotated[
        Path | None, typer.Argument(metavar="NEW", help="Another one (default: OLD with --variant or --set).")
    ] = None,
    set_: options.Sets = None,
    variant: options.VariantName = None,
    out: PictureFile = None,
    rounds: Rounds = False,
) -> None:
    """Say how two graphs or runs differ and what would run again; with -o as a picture as well.

    --variant and --set apply to NEW.
    """
    from exmesh_graph.api.differences import diff as difference_of
    from exmesh_graph.errors import GraphError

    _check_output(out)
    if new is None and not variant and not set_:
        raise GraphError("diff needs two graphs", where="command line", fix="name NEW, or give --variant or --set")
    comparison = difference_of(old, new, set=set_, variant=variant)
    typer.echo(str(comparison))
    if out is not None:
        _put_out(comparison.picture(rounds), out)


def show(
    what: Annotated[Path, typer.Argument(metavar="GRAPH|RUN", help="A graph file, or a run folder.")],
    set_: options.Sets = None,
    variant: options.VariantName = None,
    out: PictureFile = None,
    rounds: Rounds = False,
    store: options.StoreFolder = None,
) -> None:
    """Draw a graph or a run; without -o as Mermaid text for Markdown files."""
    from exmesh_graph.api.opening import checked_graph, open_store
    from exmesh_graph.api.results import read_run
    from exmesh_graph.report.drawing.states import picture_of_graph, picture_of_run

    _check_output(out)
    if what.is_dir():
        picture = picture_of_run(read_run(what), rounds)
    else:
        picture = picture_of_graph(checked_graph(what, set_, variant, store), open_store(store), rounds)
    _put_out(picture, out)


def _check_output(path: Path | None) -> None:
    """Refuse a file type that cannot be written, before any work."""
    from exmesh_graph.errors import GraphError
    from exmesh_graph.report.drawing.formats import FORMATS

    if path is not None and path.suffix not in FORMATS:
        raise GraphError(f"cannot draw {path.name}", where="command line", expected="a name in " + ", ".join(FORMATS))


def _put_out(picture: GraphPicture, path: Path | None) -> None:
    """Write a picture, or print it as Mermaid text."""
    from exmesh_graph.report.drawing.formats import render, write

    if path is None:
        typer.echo(render(picture, ".mmd"), nl=False)
    else:
        write(picture, path)
        typer.echo(str(path))


def show_table(table: Mapping[str, Any], width: int | None = None) -> None:
    """The table for a terminal: as many figures as fit, those with a direction first; sweep.csv has all."""
    from exmesh_graph.api.board import clock
    from exmesh_graph.report.sweep.table import label_of

    rows, counts = table["variants"], table["nodes"]
    several = len({row["file"] for row in rows}) > 1
    columns = [["variant", *(label_of(row, several) for row in rows)]]
    tail = [
        ["seconds", *(clock(row["seconds"]["mean"]) for row in rows)],
        ["shared", *(f"{row['shared']}/{row['nodes']}" for row in rows)],
    ]
    room = (width or shutil.get_terminal_size((110, 24)).columns) - sum(map(_width, (*columns, *tail)))
    for figure in table["figures"]:
        label = figure["label"]
        column = [f"{label} {figure['unit']}".rstrip(), *(_cell(row["figures"].get(label, {})) for row in rows)]
        if _width(column) <= room:
            room -= _width(column)
            columns.append(column)
    left_out = len(table["figures"]) + 1 - len(columns)
    columns += tail
    typer.echo("")
    for index, cells in enumerate(zip(*columns, strict=True)):
        first, *others = (cell.rjust(_width(column) - 2) for cell, column in zip(cells, columns, strict=True))
        typer.echo("  ".join([cells[0].ljust(len(first)), *others]).rstrip())
        if index and rows[index - 1]["state"] != "done":
            typer.echo(f"    {rows[index - 1]['state']}: {rows[index - 1]['reason']}")
    notes = [f"{left_out} more figures in sweep.csv"] if left_out else []
    if any(len(row["repeats"]) > 1 for row in rows):
        notes.append("± over seeds, ≈ within the spread")
    notes.append(f"{counts['from_store']} nodes from the store, {counts['run']} run, {clock(table['seconds'] or 0.0)}")
    typer.echo("\n  " + "; ".join(notes))


def _width(column: Sequence[str]) -> int:
    """Of a column with the gap before it."""
    return 2 + max(map(len, column))


def _cell(entry: Mapping[str, Any]) -> str:
    """A figure, and by how much it differs from the base."""
    from exmesh_graph.report.sweep.table import text_of
    from exmesh_graph.report.text import signed

    if "difference" not in entry:
        return text_of(entry)
    within = entry["exceeds"] is False and entry["difference"]
    return f"{text_of(entry)}  {'≈' if within else ''}{signed(entry['difference'])}"
