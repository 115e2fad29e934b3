"""Commands for rewired graphs and their pictures: `exmesh sweep`, `exmesh diff`, `exmesh show`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from exmesh_graph.cli.options import (
    BackendChoice,
    BackendName,
    RayAddress,
    RunsFolder,
    Sets,
    SharedUrl,
    StoreFolder,
    Targets,
    VariantName,
    checked_graph,
    open_store,
)

PictureFile = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FILE", help="A picture: FILE.svg, FILE.html or FILE.mmd.")
]
Rounds = Annotated[bool, typer.Option("--rounds", help="Draw every round of repeat blocks.")]


def register(app: typer.Typer) -> None:
    """Add the commands of this module to the `exmesh` command."""
    for command in (sweep, diff, show):
        app.command()(command)


def sweep(
    graphs: Annotated[list[Path], typer.Argument(metavar="GRAPH...", help="Graph files that declare variants.")],
    set_: Sets = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="VARIANT", help="This variant and the base; repeatable.")
    ] = None,
    node: Targets = None,
    plan: Annotated[bool, typer.Option("--plan", help="Only say what would run.")] = False,
    keep_going: Annotated[
        bool, typer.Option("--keep-going/--stop", help="After a failure run what does not need it.")
    ] = True,
    workers: Annotated[
        int | None, typer.Option("--workers", "--jobs", min=0, help="Worker processes at most; 0: this process.")
    ] = None,
    tokens: Annotated[str, typer.Option(metavar="cpu=4,gpu=1", help="What nodes may use together.")] = "",
    store: StoreFolder = None,
    shared: SharedUrl = None,
    runs: RunsFolder = Path("runs"),
    backend: BackendChoice = BackendName.local,
    address: RayAddress = None,
) -> None:
    """Run a graph and all variants it declares, equal nodes once, and compare them in one table."""
    from exmesh_graph.cli.running import backend_of
    from exmesh_graph.cli.sweeping import Study, run_sweep, show_plan
    from exmesh_graph.graph.run.schedule import parse_tokens

    offered = parse_tokens(tokens)
    study = Study.of(graphs, set_ or [], only, node, store)
    opened = open_store(store, shared)
    if plan:
        show_plan(study, opened)
        return
    given = {"--store": store, "--shared": shared, "--runs": None if runs == Path("runs") else runs,
             "--backend": "ray" if backend is BackendName.ray else None, "--address": address}  # fmt: skip
    words = [word for option, value in given.items() if value is not None for word in (option, str(value))]
    make = partial(backend_of, workers, kind=backend.value, address=address)
    raise typer.Exit(run_sweep(study, opened, runs, make, words, tokens=offered, keep_going=keep_going))


def diff(
    old: Annotated[Path, typer.Argument(metavar="OLD", help="A graph file or a run folder.")],
    new: Annotated[
        Path | None, typer.Argument(metavar="NEW", help="Another one (default: OLD with --variant or --set).")
    ] = None,
    set_: Sets = None,
    variant: VariantName = None,
    out: PictureFile = None,
    rounds: Rounds = False,
) -> None:
    """Say how two graphs or runs differ and what would run again; with -o as a picture as well.

    --variant and --set apply to NEW.
    """
    from exmesh_graph.cli.drawing import Side, check_output, picture_of_difference, put_out, show_difference
    from exmesh_graph.errors import GraphError

    check_output(out)
    if new is None and not variant and not set_:
        raise GraphError("diff needs two graphs", where="command line", fix="name NEW, or give --variant or --set")
    before, after = Side(old, None, None), Side(new or old, set_, variant)
    show_difference(before, after)
    if out is not None:
        put_out(picture_of_difference(before, after, rounds), out)


def show(
    what: Annotated[Path, typer.Argument(metavar="GRAPH|RUN", help="A graph file, or a run folder.")],
    set_: Sets = None,
    variant: VariantName = None,
    out: PictureFile = None,
    rounds: Rounds = False,
    store: StoreFolder = None,
) -> None:
    """Draw a graph or a run; without -o as Mermaid text for Markdown files."""
    from exmesh_graph.cli.drawing import check_output, put_out
    from exmesh_graph.cli.show import read_run
    from exmesh_graph.report.drawing.states import picture_of_graph, picture_of_run

    check_output(out)
    if what.is_dir():
        picture = picture_of_run(read_run(what), rounds)
    else:
        checked, _ = checked_graph(what, set_, variant)
        picture = picture_of_graph(checked, open_store(store), rounds)
    put_out(picture, out)
