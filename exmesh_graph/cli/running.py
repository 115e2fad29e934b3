"""`exmesh run`: a run with its live view, its report and its summary."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import typer

from exmesh_graph.api.board import clock
from exmesh_graph.api.progress import view
from exmesh_graph.errors import StoreError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.language.check import Checked
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import NodeFailed, Run
from exmesh_graph.types import Artifact


def run_graph(
    graph: Checked, store: Store, runs: Path, packs: Packs, make: Callable[[Store], Backend], **options: Any
) -> int:
    """Run a checked graph, print what happens, return the exit code. `options` are those of `Run`."""
    backend = make(store)
    folder = RunFolder(runs, graph.name)
    for module, why in packs.broken.items():
        typer.echo(f"warning: the node module {module} cannot be imported: {why}", err=True)
    try:
        with view(graph, folder.id) as listener:
            record = Run(graph, store, folder, listener, backend=backend, **options).run()
    except NodeFailed as failure:
        _show_failure(failure, folder.path)
        return 1
    except KeyboardInterrupt:
        typer.echo(f"\ninterrupted; go on with the same command:\n  {options['command']}", err=True)
        return 130
    finally:
        folder.close()
        for note in store.notes:
            typer.echo(f"store: {note}", err=True)
    code = 0
    try:
        make_report(folder.path, record, store)
    except Exception as error:
        typer.echo(f"error: all nodes are done, but the report failed: {type(error).__name__}: {error}", err=True)
        typer.echo(f"  again: exmesh report {folder.path}", err=True)
        code = 1
    summary(folder.path, record)
    show_benchmarks(folder.path, record, store)
    return code


def backend_of(workers: int | None, store: Store, kind: str = "local", address: str | None = None) -> Backend:
    """local: this process for 0 workers, else worker processes, as many as the machine can take for None; or ray."""
    if kind == "ray":
        from exmesh_graph.graph.run.backends.ray import RayCluster

        return RayCluster(store, address)
    from exmesh_graph.graph.run.backends.inline import Inline
    from exmesh_graph.graph.run.backends.local import Local

    return Inline(store) if workers == 0 else Local(workers)


def make_report(folder: Path, record: Mapping[str, Any], store: Store) -> None:
    """report.json and report.html of a run."""
    from exmesh_graph.report import build_report

    build_report(folder, record, loader(store))


def show_benchmarks(folder: Path, record: Mapping[str, Any], store: Store) -> None:
    """Print the paper's table of every benchmark that the run scored, and write it as <table>.md into its folder."""
    from exmesh_graph.evaluate.protocols.published import as_markdown, as_text, paper_table
    from exmesh_graph.report.collect import collect_benchmarks

    scored = collect_benchmarks(record, loader(store))
    for name in dict.fromkeys(entry["table"] for entry in scored):
        rows = paper_table(name, [entry for entry in scored if entry["table"] == name])
        (folder / f"{name}.md").write_text(as_markdown(rows), encoding="utf-8")
        typer.echo(f"\n{as_text(rows)}\n  {_short(folder / f'{name}.md')}")


def loader(store: Store) -> Callable[[str], Artifact]:
    """`load_artifact(digest)`: the value of any artifact in the store."""

    def load_artifact(digest: str) -> Artifact:
        name = store.type_of(digest)
        kinds = artifact_types()
        if name is None or name not in kinds:
            known = "is not in the store" if name is None else f"has the type {name}, which no node pack defines"
            raise StoreError(f"the artifact {digest} {known}", fix="run the graph again")
        value = store.load(kinds[name], digest)
        if value is None:
            raise StoreError(store.notes[-1], fix="run the graph again")
        return value

    return load_artifact


def summary(folder: Path, record: Mapping[str, Any]) -> None:
    """One screen: states, the costly nodes, headline figures, warnings, where the results lie."""
    rows = record["nodes"]
    hits = sum(row["state"] == "hit" for row in rows)
    typer.echo(f"\n{record['graph']}: {len(rows)} nodes, {hits} from the store, {len(rows) - hits} run, "
               f"{clock(record['seconds'])}")  # fmt: skip
    slow = sorted((row for row in rows if row["state"] == "done"), key=lambda row: -row["seconds"])[:5]
    if slow and slow[0]["seconds"] >= 0.1:
        typer.echo("  longest: " + ", ".join(f"{row['name']} {clock(row['seconds'])}" for row in slow))
    for name, value in _headline(folder).items():
        typer.echo(f"  {name}: {_figure(value)}")
    warned = [(row["name"], text) for row in rows for text in row["warnings"]]
    for node, text in warned[:5]:
        typer.echo(f"  warning: {node}: {text}")
    if len(warned) > 5:
        typer.echo(f"  ... and {len(warned) - 5} more warnings, all in run.json")
    for name, path in record["published"].items():
        typer.echo(f"  {name}: {_short(folder / path)}")
    report = folder / "report.html"
    typer.echo(f"  report: {_short(report)}" if report.is_file() else f"  run: {_short(folder)}")


def _headline(folder: Path) -> dict[str, Any]:
    path = folder / "report.json"
    if not path.is_file():
        return {}
    headline = json.loads(path.read_text(encoding="utf-8")).get("headline", {})
    return dict(headline) if isinstance(headline, dict) else {}


def _figure(value: Any) -> str:
    """`31.2 dB (floor 20.1, after 40 s)` from a plain value or from {value, unit, floor, after_seconds, ...}.

    The floor is what an uninformed guess scores; the seconds are those spent until the figure was reached.
    """
    if not isinstance(value, dict):
        if isinstance(value, bool):
            return "yes" if value else "no"
        return f"{value:.4g}" if isinstance(value, float) else str(value)
    notes = []
    if value.get("floor") is not None:
        notes.append(f"floor {_figure(value['floor'])}")
    if value.get("after_seconds") is not None:
        notes.append(f"after {clock(float(value['after_seconds']))}")
    tail = f" ({', '.join(notes)})" if notes else ""
    return f"{_figure(value.get('value'))} {value.get('unit') or ''}".rstrip() + tail


def _show_failure(failure: NodeFailed, folder: Path) -> None:
    typer.echo("", err=True)
    for record in failure.records:
        typer.echo(f"failed: {record['node']}: {record['message']}", err=True)
        if record.get("at"):
            typer.echo(f"  at {record['at']}", err=True)
        typer.echo(f"  details: {_short(folder / record['file'])}", err=True)
        if record["job"] is not None:
            typer.echo(
                f"  this node alone, on the same inputs: exmesh replay {_short(folder / record['file'])}", err=True
            )
        typer.echo(f"  this node as the graph is now: {record['replay']}", err=True)
    typer.echo(f"  go on when mended: {failure.record['run_again']}", err=True)


def _short(path: Path) -> str:
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
