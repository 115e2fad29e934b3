"""The commands of `exmesh`. Each imports what it needs when it runs, so that help and checks answer at once.

Exit codes: 0 done; 1 a node, the store or the report failed; 2 the graph or the command line is wrong; 130 Ctrl-C.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
import warnings
from collections.abc import Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exmesh_graph.cli import assets, authoring, bench, options, studio, upkeep, variants, watching
from exmesh_graph.errors import ExmeshError

if TYPE_CHECKING:
    from exmesh_graph.api.planning import Why


def _show_version(asked: bool) -> None:
    if asked:
        from exmesh_graph.version import __version__

        typer.echo(f"exmesh {__version__}")
        raise typer.Exit


app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Photographs to relightable USD assets, as a cached graph of typed nodes.",
)


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Photographs to relightable USD assets, as a cached graph of typed nodes."""


@app.command()
def run(
    graph: options.GraphFile,
    set_: options.Sets = None,
    variant: options.VariantName = None,
    node: options.Targets = None,
    force: Annotated[
        list[str] | None,
        typer.Option("--force", metavar="NODE", help="Run this node even on a hit; repeatable, `*` for anything."),
    ] = None,
    from_: Annotated[
        list[str] | None, typer.Option("--from", metavar="NODE", help="Run this node and all below it again.")
    ] = None,
    store: options.StoreFolder = None,
    shared: options.SharedUrl = None,
    runs: options.RunsFolder = Path("runs"),
    workers: Annotated[
        int | None, typer.Option(min=0, help="Worker processes at most; 0 runs all nodes in this process.")
    ] = None,
    backend: options.BackendChoice = options.BackendName.local,
    address: options.RayAddress = None,
    tokens: Annotated[str, typer.Option(metavar="cpu=4,gpu=1", help="What nodes may use together.")] = "",
    keep_going: Annotated[
        bool, typer.Option("--keep-going", help="After a failure run what does not need it.")
    ] = False,
) -> None:
    """Run a graph. What is in the store already is not run again, so the same command also resumes."""
    from exmesh_graph.api.runs import RunFailed
    from exmesh_graph.api.runs import run as run_graph
    from exmesh_graph.cli.running import resumable, show_benchmarks, show_failure, summary

    with resumable():
        try:
            done = run_graph(
                graph, set=set_, variant=variant, nodes=node, force=force, start=from_, store=store, shared=shared,
                runs=runs, workers=workers, backend=backend.value, address=address, tokens=tokens,
                keep_going=keep_going, progress=True,
            )  # fmt: skip
        except RunFailed as failure:
            show_failure(failure.run)
            options.show_notes(failure.run.store)
            raise typer.Exit(1) from None
    options.show_notes(done.store)
    if done.report_error:
        typer.echo(f"  again: exmesh report {done.folder}", err=True)
    summary(done)
    show_benchmarks(done)
    raise typer.Exit(1 if done.report_error else 0)


@app.command()
def check(graph: options.GraphFile, set_: options.Sets = None, variant: options.VariantName = None) -> None:
    """Check a graph and its variants: types, wires, parameters, source files; list what --set can change."""
    from exmesh_graph.api.opening import checked_graph, checked_variants
    from exmesh_graph.api.planning import idle_line

    variants: list[str] = []
    if variant:
        checked = checked_graph(graph, set_, variant)
    else:
        rows = checked_variants(graph, set_, repeats=False)
        checked, variants = rows[0].checked, [row.name for row in rows[1:]]
    sources = sum(len(bound.sources) for bound in checked.nodes.values())
    typer.echo(f"{checked.name}: {len(checked.nodes)} nodes, {sources} source files, no faults")
    if checked.idle:
        typer.echo(f"  {idle_line(checked)}")
    for name, declared in checked.declared.items():
        typer.echo(f"  {name} = {checked.params[name]!r}{'' if declared.inferred else f'  ({declared})'}")
        for choice, settings in groupby(declared.settings(), key=itemgetter(0)):
            typer.echo(f"      {choice}: " + ", ".join(f"{other} = {value!r}" for _, other, value, _ in settings))
    if variants:
        typer.echo(f"  {len(variants)} variants, no faults: {', '.join(variants)}")


@app.command()
def plan(
    graph: options.GraphFile,
    set_: options.Sets = None,
    variant: options.VariantName = None,
    node: options.Targets = None,
    store: options.StoreFolder = None,
    shared: options.SharedUrl = None,
    as_json: options.AsJson = False,
) -> None:
    """Show what a run would do with each node, and why."""
    from exmesh_graph.api.planning import plan as steps_of

    steps = steps_of(graph, set=set_, variant=variant, nodes=node, store=store, shared=shared)
    if as_json:
        options.put_json(steps.as_json())
    else:
        typer.echo(str(steps))
    options.show_notes(steps.store)


@app.command()
def why(
    node: Annotated[str, typer.Argument(help="The node's name, e.g. pbr or rounds[3].refine.")],
    graph: Annotated[Path | None, typer.Argument(help="The graph (default: that of the latest run).")] = None,
    set_: options.Sets = None,
    variant: options.VariantName = None,
    store: options.StoreFolder = None,
    runs: options.RunsFolder = Path("runs"),
    as_json: options.AsJson = False,
) -> None:
    """Say why a node is a hit or must run: its key, and what differs from the nearest earlier record."""
    from exmesh_graph.api.planning import why as explain
    from exmesh_graph.api.results import read_run
    from exmesh_graph.api.runs import command_words

    words = command_words(set_ or (), {"--variant": variant, "--store": store, "--runs": _given(runs)})
    if graph is not None:
        words.insert(0, str(graph))
    else:
        record = read_run(runs / "latest")
        graph, set_ = Path(record["file"]), [*record["overrides"], *(set_ or [])]
        variant = variant or record["resolved"].get("variant")
    answer = explain(graph, node, set=set_, variant=variant, store=store)
    options.put_json(answer.as_json()) if as_json else _show_why(answer, words)


def _show_why(why: Why, words: Sequence[str]) -> None:
    """The state of a node, its key, and what differs from the nearest earlier record.

    `words` of the command line name the graph, for the next command.
    """
    typer.echo(f"{why.node}: {why.state}")
    if why.key is None:
        typer.echo(f"  {why.reason}; its key is known only when that has run")
        typer.echo("  " + shlex.join(["exmesh", "why", why.waits_for, *words]))
        return
    typer.echo(f"  key {why.key}")
    if why.made:
        typer.echo(f"  made {why.made}")
    for line in why.lines:
        typer.echo(f"  {line}")
    typer.echo("  the key depends on:")
    for field, value in why.depends_on.items():
        if field == "code":
            typer.echo("    code: " + ", ".join(value))
        else:
            typer.echo(f"    {field}: {', '.join(value)}" if isinstance(value, list) else f"    {field} {value}")
    if why.not_in_key or why.undeclared:
        typer.echo("  not in the key:")
        for place in why.not_in_key:
            typer.echo(f"    {place}")
        if why.undeclared:
            typer.echo("    versions of libraries that are not declared: " + ", ".join(why.undeclared))


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="A run folder.")] = Path("runs/latest"), store: options.StoreFolder = None
) -> None:
    """Build a run's report again."""
    from exmesh_graph.api.runs import open_run

    typer.echo(str(open_run(run, store=store).make_report()))


@app.command()
def get(
    output: Annotated[str, typer.Argument(metavar="NODE.PORT", help="An output: hull.mesh, rounds[3].uv.state.")],
    run: Annotated[Path, typer.Option("--run", help="A run folder.")] = Path("runs/latest"),
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FOLDER", help="Where its files go (default: NODE.PORT).")
    ] = None,
    store: options.StoreFolder = None,
) -> None:
    """Copy the files of an artifact out of the store, checked, and say what it is."""
    from exmesh_graph.api.runs import open_run
    from exmesh_graph.api.upkeep import shown_bytes

    opened = open_run(run, store=store)
    folder = opened.save(output, out or Path(output))
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    node, _, port = output.rpartition(".")
    kind = opened[node].info["outputs"][port]["type"]
    typer.echo(f"{folder}: {kind}, {shown_bytes(sum(path.stat().st_size for path in files))}")
    for path in files[:20]:
        typer.echo(f"  {path.relative_to(folder)}")
    if len(files) > 20:
        typer.echo(f"  ... and {len(files) - 20} more files")


for _command in (
    assets.view, authoring.nodes, authoring.schema, authoring.stubs, bench.bench, upkeep.verify, upkeep.pin,
    upkeep.unpin, upkeep.gc, upkeep.push, upkeep.pull, upkeep.doctor, variants.sweep, variants.diff, variants.show,
    watching.status, watching.log, watching.prov, watching.replay, studio.studio,
):  # fmt: skip
    app.command()(_command)
app.command("check-usd")(assets.check_usd)
app.command("new-node")(authoring.new_node)


def run_app() -> None:
    """Run the command line; every expected error becomes a message and an exit code."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = _show_warning
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


def _show_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
) -> None:
    """A line for what the front door warns of; what libraries warn of as Python does."""
    if category is UserWarning:
        typer.echo(f"warning: {message}", err=True)
    else:
        typer.echo(warnings.formatwarning(message, category, filename, lineno), err=True, nl=False)


def _interrupt(signum: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _given(runs: Path) -> Path | None:
    return None if runs == Path("runs") else runs
