"""The commands of `exmesh`. Each imports what it needs when it runs, so that help and checks answer at once.

Exit codes: 0 done; 1 a node, the store or the report failed; 2 the graph or the command line is wrong; 130 Ctrl-C.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from exmesh_graph.cli import assets, authoring, bench, upkeep, variants, watching
from exmesh_graph.cli.options import (
    BackendChoice,
    BackendName,
    GraphFile,
    RayAddress,
    RunsFolder,
    Sets,
    SharedUrl,
    StoreFolder,
    Targets,
    VariantName,
    checked_graph,
    checked_variants,
    named,
    open_store,
    show_notes,
)
from exmesh_graph.errors import ExmeshError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Photographs to relightable USD assets, as a cached graph of typed nodes.",
)


@app.command()
def run(
    graph: GraphFile,
    set_: Sets = None,
    variant: VariantName = None,
    node: Targets = None,
    force: Annotated[
        list[str] | None, typer.Option("--force", metavar="NODE", help="Run this node even on a hit; repeatable.")
    ] = None,
    store: StoreFolder = None,
    shared: SharedUrl = None,
    runs: RunsFolder = Path("runs"),
    workers: Annotated[
        int | None, typer.Option(min=0, help="Worker processes at most; 0 runs all nodes in this process.")
    ] = None,
    backend: BackendChoice = BackendName.local,
    address: RayAddress = None,
    tokens: Annotated[str, typer.Option(metavar="cpu=4,gpu=1", help="What nodes may use together.")] = "",
    keep_going: Annotated[
        bool, typer.Option("--keep-going", help="After a failure run what does not need it.")
    ] = False,
) -> None:
    """Run a graph. What is in the store already is not run again, so the same command also resumes."""
    from exmesh_graph.cli.running import backend_of, run_graph
    from exmesh_graph.graph.cache.store import writable
    from exmesh_graph.graph.run.schedule import parse_tokens

    offered = parse_tokens(tokens)
    checked, packs = checked_graph(graph, set_, variant, store)
    targets = checked.needed_for(named(checked, node)) if node else None
    forced = set(named(checked, force))
    command = _command(graph, set_, store, runs, variant, shared)
    command += "" if workers is None else f" --workers {workers}"
    command += f" --tokens {shlex.quote(tokens)}" if tokens else ""
    command += " --keep-going" if keep_going else ""
    if backend is BackendName.ray:
        command += " --backend ray" + (f" --address {address}" if address else "")
    only = "".join(f" --node {shlex.quote(name)}" for name in node or ())
    with writable(open_store(store, shared)) as opened:
        code = run_graph(
            checked,
            opened,
            runs,
            packs,
            partial(backend_of, workers, kind=backend.value, address=address),
            targets=targets,
            force=forced,
            command=command + only,
            alone=command,
            overrides=tuple(set_ or ()),
            tokens=offered,
            keep_going=keep_going,
        )
    raise typer.Exit(code)


@app.command()
def check(graph: GraphFile, set_: Sets = None, variant: VariantName = None) -> None:
    """Check a graph and its variants: types, wires, parameters, source files; list what --set can change."""
    variants: list[str] = []
    if variant:
        checked, _ = checked_graph(graph, set_, variant)
    else:
        rows, _ = checked_variants(graph, set_, repeats=False)
        checked, variants = rows[0].checked, [row.name for row in rows[1:]]
    sources = sum(len(bound.sources) for bound in checked.nodes.values())
    typer.echo(f"{checked.name}: {len(checked.nodes)} nodes, {sources} source files, no faults")
    for name, declared in checked.declared.items():
        typer.echo(f"  {name} = {checked.params[name]!r}{'' if declared.inferred else f'  ({declared})'}")
    if variants:
        typer.echo(f"  {len(variants)} variants, no faults: {', '.join(variants)}")


@app.command()
def plan(
    graph: GraphFile,
    set_: Sets = None,
    variant: VariantName = None,
    node: Targets = None,
    store: StoreFolder = None,
    shared: SharedUrl = None,
) -> None:
    """Show what a run would do with each node, and why."""
    from exmesh_graph.graph.run.plan import HIT, RUN, UNKNOWN
    from exmesh_graph.graph.run.plan import plan as make_plan

    checked, _ = checked_graph(graph, set_, variant, store)
    targets = checked.needed_for(named(checked, node)) if node else None
    opened = open_store(store, shared)
    steps = make_plan(checked, opened, targets)
    width = max(len(step.name) for step in steps)
    for step in steps:
        typer.echo(f"{step.state:<8}{step.name:<{width + 2}}{step.reason}".rstrip())
    counts = {state: sum(step.state == state for step in steps) for state in (HIT, RUN, UNKNOWN)}
    typer.echo(f"{counts[HIT]} hit, {counts[RUN]} to run, {counts[UNKNOWN]} unknown (below a node that must run)")
    show_notes(opened)


@app.command()
def why(
    node: Annotated[str, typer.Argument(help="The node's name, e.g. pbr or rounds[3].refine.")],
    graph: Annotated[Path | None, typer.Argument(help="The graph (default: that of the latest run).")] = None,
    set_: Sets = None,
    variant: VariantName = None,
    store: StoreFolder = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Say why a node is a hit or must run: its key, and what differs from the nearest earlier record."""
    from exmesh_graph.cli.show import read_run, show_why

    words = _options(set_, store, runs, variant)
    if graph is not None:
        words.insert(0, str(graph))
    else:
        record = read_run(runs / "latest")
        graph, set_ = Path(record["file"]), [*record["overrides"], *(set_ or [])]
        variant = variant or record["resolved"].get("variant")
    checked, _ = checked_graph(graph, set_, variant, store)
    name = named(checked, [node])[0]
    show_why(checked, name, open_store(store), words)


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="A run folder.")] = Path("runs/latest"), store: StoreFolder = None
) -> None:
    """Build a run's report again."""
    from exmesh_graph.cli.running import make_report
    from exmesh_graph.cli.show import read_run
    from exmesh_graph.graph.declare.packs import load_packs

    load_packs()
    record = read_run(run)
    folder = run.resolve()
    make_report(folder, record, open_store(store))
    typer.echo(str(folder / "report.html"))


assets.register(app)
authoring.register(app)
bench.register(app)
upkeep.register(app)
variants.register(app)
watching.register(app)


def run_app() -> None:
    """Run the command line; every expected error becomes a message and an exit code."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        app()
    except ExmeshError as error:
        typer.echo(str(error), err=True)
        sys.exit(2 if error.code == "graph" else 1)
    except BrokenPipeError:  # the reader of a pipe is gone (exmesh nodes | head)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:  # a full disk, a folder that may not be written
        typer.echo(f"error: {error}", err=True)
        sys.exit(1)
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        sys.exit(130)


def _interrupt(signum: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _command(
    graph: Path,
    sets: list[str] | None,
    store: Path | None,
    runs: Path,
    variant: str | None = None,
    shared: str | None = None,
) -> str:
    """The command that runs this again, for the messages."""
    return shlex.join(["exmesh", "run", str(graph), *_options(sets, store, runs, variant, shared)])


def _options(
    sets: list[str] | None, store: Path | None, runs: Path, variant: str | None, shared: str | None = None
) -> list[str]:
    words = []
    for text in sets or []:
        words += ["--set", text]
    if variant:
        words += ["--variant", variant]
    if store is not None:
        words += ["--store", str(store)]
    if shared:
        words += ["--shared", shared]
    if runs != Path("runs"):
        words += ["--runs", str(runs)]
    return words
