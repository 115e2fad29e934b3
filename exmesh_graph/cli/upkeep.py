"""`exmesh verify`, `pin`, `gc`, `push`, `pull`, `doctor`: looking after stores and after the machine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from exmesh_graph.cli.options import RunsFolder, SharedUrl, StoreFolder, show_notes
from exmesh_graph.errors import ExmeshError


def verify(store: StoreFolder = None) -> None:
    """Read the whole store and check every byte; what is broken goes to quarantine and is made again."""
    from exmesh_graph.api import upkeep

    opened = upkeep.existing(store)
    objects, actions = (len(list(opened.root.glob(f"{kind}/*/*"))) for kind in ("objects", "actions"))
    quarantine = opened.root / "quarantine"
    before = len(list(quarantine.glob("*")))
    broken = 0
    for what, reason in upkeep.verify(store):
        broken += what != "lease"
        typer.echo(f"{what}: {reason}")
    moved = len(list(quarantine.glob("*"))) - before
    typer.echo(f"{objects} objects and {actions} actions read, {moved} moved to quarantine")
    raise typer.Exit(1 if broken else 0)


def pin(
    what: Annotated[
        str | None, typer.Argument(metavar="RUN|KEY", help="A run (its folder or id), or a key of `exmesh why`.")
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="How the pin is called.")] = None,
    store: StoreFolder = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Keep the results of a run, or of one key, whatever `gc` removes. Without arguments: list the pins."""
    from exmesh_graph.api import upkeep

    if what is None:
        for entry in upkeep.pinned(store):
            typer.echo(str(entry))
    elif name is None:
        raise ExmeshError("a pin needs a name", fix=f"exmesh pin {what} --name NAME")
    else:
        typer.echo(f"pinned: {upkeep.pin(what, name, store=store, runs=runs)}")


def unpin(name: Annotated[str, typer.Argument(help="The pin's name.")], store: StoreFolder = None) -> None:
    """Remove a pin; what it kept goes with the next `gc` that finds no other need for it."""
    from exmesh_graph.api import upkeep

    typer.echo(f"removed: {upkeep.unpin(name, store)}")


def gc(
    delete: Annotated[bool, typer.Option("--delete", help="Remove it; without this, only say what would go.")] = False,
    budget: Annotated[
        str | None, typer.Option(metavar="SIZE", help="Most bytes to keep, e.g. 5GB: the oldest unpinned go first.")
    ] = None,
    age: Annotated[str, typer.Option(metavar="TIME", help="Keep what was used within this time, e.g. 30d.")] = "1h",
    store: StoreFolder = None,
    runs: Annotated[
        list[Path] | None,
        typer.Option("--runs", help="A folder of runs that are needed, beside the known; repeatable."),
    ] = None,
) -> None:
    """Find what no run and no pin needs any more, and remove it with --delete. Safe beside runs."""
    from exmesh_graph.api import upkeep
    from exmesh_graph.api.upkeep import shown_bytes

    opened = upkeep.existing(store)
    gone, survey = upkeep.gc(opened, runs=runs or [Path("runs")], age=age, budget=budget, delete=delete)
    for item in gone if len(gone) <= 40 else sorted(gone, key=lambda item: -item.bytes)[:40]:
        typer.echo(f"{shown_bytes(item.bytes):>10}  {item.kind} {item.name[:16]}  {item.why}")
    if len(gone) > 40:
        typer.echo(f"{'':>10}  ... and {len(gone) - 40} smaller ones")
    for note in survey.notes:
        typer.echo(f"note: {note}")
    counts = Counter(item.kind for item in gone)
    kinds = ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in counts.items())
    words = "removed" if delete else "would be removed (with --delete)"
    size = sum(item.bytes for item in gone)
    typer.echo(f"{kinds or 'nothing'} {words}, {shown_bytes(size)}; {shown_bytes(survey.kept_bytes)} stay, "
               f"needed by {survey.runs} runs and {survey.pinned} pinned results")  # fmt: skip
    show_notes(opened)


def push(
    run: Annotated[str, typer.Argument(metavar="RUN", help="The run: its folder or id.")] = "latest",
    shared: SharedUrl = None,
    store: StoreFolder = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Send a run to the shared store: its results, and its folder."""
    from exmesh_graph.api import sharing

    told = sharing.push(run, shared=shared, store=store, runs=runs)
    typer.echo(f"sent {told.run}: {told.results} results and its folder; elsewhere: exmesh pull {told.run}")
    _missing(told.missing, "are in the store no more: run the graph again, and push again")


def pull(
    run: Annotated[str | None, typer.Argument(metavar="RUN", help="Its id; left out: lists what is there.")] = None,
    shared: SharedUrl = None,
    store: StoreFolder = None,
    runs: RunsFolder = Path("runs"),
) -> None:
    """Bring a run from the shared store: its results, and its folder. Without a run: list what is there."""
    from exmesh_graph.api import sharing

    if run is None:
        for row in sharing.shared_runs(shared, store):
            typer.echo(f"{row['state']:<12}{row['id']}  {row['graph']}, {len(row['keys'])} results")
        return
    told = sharing.pull(run, shared=shared, store=store, runs=runs)
    typer.echo(f"brought {told.run} into {told.folder}: {told.results} results")
    _missing(told.missing, "could not be had: a run of the graph makes them again")


def _missing(names: Sequence[str], why: str) -> None:
    if names:
        shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
        typer.echo(f"the results of {shown} {why}", err=True)
        raise typer.Exit(1)


def doctor(
    store: StoreFolder = None,
    shared: SharedUrl = None,
    gpu: Annotated[
        bool, typer.Option("--gpu", help="Compare every accelerated operation on CUDA and the CPU.")
    ] = False,
) -> None:
    """Try what runs need: the store's file system, libraries, the GPU. Exits with 1 if runs would fail."""
    from exmesh_graph.api.doctor import FAIL, WARN, examine_gpu, findings

    counts: Counter[str] = Counter()
    for finding in examine_gpu() if gpu else findings(store, shared):
        typer.echo(str(finding))
        counts[finding.state] += 1
    mend, know = counts[FAIL], counts[WARN]
    typer.echo(f"{mend} to mend, {know} to know" if mend + know else "all is well")
    raise typer.Exit(1 if mend else 0)
