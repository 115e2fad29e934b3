"""`exmesh studio`: a graph and its runs in the browser, to see, steer and rewire."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from exmesh_graph.cli import options
from exmesh_graph.errors import ExmeshError


def studio(
    what: Annotated[Path, typer.Argument(metavar="[GRAPH|RUN]", help="A graph file, or a run folder.")] = Path(
        "runs/latest"
    ),
    set_: options.Sets = None,
    variant: options.VariantName = None,
    store: options.StoreFolder = None,
    shared: options.SharedUrl = None,
    runs: options.RunsFolder = Path("runs"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port on this machine; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Open a live page on this machine: watch runs, look at artifacts, change, rewire and compare a graph."""
    from exmesh_graph.studio.serving import serve
    from exmesh_graph.studio.workspace import Workspace

    if what.is_dir():
        workspace = Workspace.of_run(what, store=store, shared=shared)
    elif what.is_file():
        workspace = Workspace(what, store=store, shared=shared, runs=runs, variant=variant or "", sets=set_ or ())
    else:
        fix = "name a graph file, or run one first: exmesh run GRAPH"
        raise ExmeshError(f"there is no graph and no run {what}", expected="a graph file or a run folder", fix=fix)

    def ready(address: str) -> None:
        typer.echo(f"the studio is at {address}\n  Ctrl-C ends it; runs that it started go on")
        if browser:
            webbrowser.open(address)

    serve(workspace, port, ready)
