"""`exmesh sweep`: all variants merged into one graph, run, and told in one table."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from exmesh_graph.api.board import clock
from exmesh_graph.api.progress import view
from exmesh_graph.cli.options import checked_variants
from exmesh_graph.cli.running import loader, show_benchmarks
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.problems import GraphErrors, Problem, nearest
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.plan import HIT, RUN, UNKNOWN, plan
from exmesh_graph.graph.run.rundir import RunFolder
from exmesh_graph.graph.run.runner import NodeFailed, Run
from exmesh_graph.graph.variants import CheckedVariant, Merged, merge, variant_names
from exmesh_graph.report.sweep.files import write_sweep
from exmesh_graph.report.sweep.pictures import sweep_pictures
from exmesh_graph.report.sweep.table import label_of, sweep_table, text_of
from exmesh_graph.report.text import signed

BASE = "base"


@dataclass(frozen=True)
class Study:
    """What a sweep runs: (name of the graph file, variant) in order, and their merged graph."""

    rows: list[tuple[str, CheckedVariant]]
    merged: Merged
    targets: set[str] | None
    packs: Packs
    words: list[str]
    overrides: tuple[str, ...]

    @classmethod
    def of(
        cls,
        files: Sequence[Path],
        sets: list[str],
        only: list[str] | None,
        targets: list[str] | None,
        store: Path | None,
    ) -> Study:
        """Check all variants of all files; the faults of all files are raised at once."""
        rows: list[tuple[str, CheckedVariant]] = []
        problems: list[Problem] = []
        packs, files = Packs(), list(dict.fromkeys(files))
        stems = [file.stem for file in files]
        for file in files:
            try:
                found, packs = checked_variants(file, sets, store, only=_known(only, file, files))
                title = file.stem if stems.count(file.stem) == 1 else str(file.with_suffix(""))
                rows += [(title, variant) for variant in found if only is None or len(found) > 1 or BASE in only]
            except GraphErrors as error:
                problems += [problem for problem in error.problems if problem not in problems]
        if problems:
            raise GraphErrors(problems)
        several = len({title for title, _ in rows}) > 1
        labels = [_label(file, variant, several) for file, variant in rows]
        name = "-".join(dict.fromkeys(file.stem for file in files))
        merged = merge(zip(labels, (variant.checked for _, variant in rows), strict=True), name=f"{name}-sweep")
        needed = None
        if targets:
            known = dict.fromkeys(name for member in merged.members for name in member.names)
            known |= dict.fromkeys(merged.checked.nodes)  # as messages name them: `direct:pbr`
            for target in targets:
                if target not in known:
                    near = nearest(target, known) or list(known)[:8]
                    raise GraphError(
                        f"no variant has a node {target!r}", where="command line", expected=", ".join(near)
                    )
            ends = [member.names[t] for member in merged.members for t in targets if t in member.names]
            ends += [t for t in targets if t in merged.checked.nodes]
            needed = merged.checked.needed_for(ends)
        words = ["exmesh", "sweep", *map(str, files)]
        for option, values in (("--set", sets), ("--only", only or []), ("--node", targets or [])):
            words += [word for value in values for word in (option, value)]
        return cls(rows, merged, needed, packs, words, tuple(sets))

    def members(self) -> list[dict[str, Any]]:
        """The variants as plain JSON-like data, for the table."""
        return [
            {"variant": variant.name, "file": file, "repeat": variant.repeat, "seed": variant.seed,
             "settings": dict(variant.settings), "doc": variant.doc, "nodes": dict(member.names)}
            for (file, variant), member in zip(self.rows, self.merged.members, strict=True)
        ]  # fmt: skip

    def say(self) -> str:
        """One line on the size of the sweep."""
        names = dict.fromkeys((file, variant.name) for file, variant in self.rows)
        repeats = len(self.rows) // len(names)
        times = f" x {repeats} seeds" if repeats > 1 else ""
        total = sum(len(member.names) for member in self.merged.members)
        return f"{len(names)} variants{times}: {total} nodes, {len(self.merged.checked.nodes)} after sharing"


def show_plan(study: Study, store: Store) -> None:
    """What a sweep would run, per variant."""
    steps = {step.name: step.state for step in plan(study.merged.checked, store, study.targets, reasons=False)}
    typer.echo(study.say())
    width = max(len(member.label) for member in study.merged.members)
    seen: set[str] = set()
    for member in study.merged.members:
        states = [steps[name] for name in member.names.values() if name in steps]
        new = {name for name in member.names.values() if name in steps} - seen
        seen |= new
        counts = ", ".join(f"{states.count(state)} {word}" for state, word in ((HIT, "hit"), (RUN, "to run"),
                                                                               (UNKNOWN, "unknown")))  # fmt: skip
        typer.echo(f"{member.label:<{width + 2}}{len(states)} nodes, {len(new)} not shared with those above: {counts}")
    counts = ", ".join(f"{list(steps.values()).count(s)} {w}" for s, w in ((HIT, "hit"), (RUN, "to run")))
    typer.echo(f"{counts}, {list(steps.values()).count(UNKNOWN)} unknown (below a node that must run)")


def run_sweep(
    study: Study, store: Store, runs: Path, make: Callable[[Store], Backend], words: Sequence[str], **options: Any
) -> int:
    """Run a study, write and print its table, return the exit code. `options` are those of `Run`."""
    graph, command = study.merged.checked, shlex.join([*study.words, *words])
    backend = make(store)
    folder = RunFolder(runs, graph.name)
    for module, why in study.packs.broken.items():
        typer.echo(f"warning: the node module {module} cannot be imported: {why}", err=True)
    typer.echo(study.say())
    records: list[Mapping[str, Any]] = []
    try:
        with view(graph, folder.id) as listener:
            work = Run(graph, store, folder, listener, backend=backend, targets=study.targets,
                       command=command, overrides=study.overrides, **options)  # fmt: skip
            work.run()
    except NodeFailed as failure:
        records = failure.records
    except KeyboardInterrupt:
        typer.echo(f"\ninterrupted; go on with the same command:\n  {command}", err=True)
        return 130
    finally:
        folder.close()
        for note in store.notes:
            typer.echo(f"store: {note}", err=True)
    failures = {str(record["node"]): str(record["message"]) for record in records}
    table = sweep_table(work.record, study.members(), loader(store), failures)
    shown = sweep_pictures(work.record, study.members(), loader(store))
    page = write_sweep(folder.path, table, shown)
    show_table(table)
    show_benchmarks(folder.path, work.record, store)
    for record in [record for record in records if record["job"] is not None][:5]:
        typer.echo(
            f"  {record['node']} alone, on the same inputs: exmesh replay {_short(folder.path / record['file'])}"
        )
    typer.echo(f"  {_short(page)}")
    return 1 if failures else 0


def show_table(table: Mapping[str, Any], width: int | None = None) -> None:
    """The table for a terminal: as many figures as fit, those with a direction first; sweep.csv has all."""
    width = width or shutil.get_terminal_size((110, 24)).columns
    several = len({row["file"] for row in table["variants"]}) > 1
    rows = table["variants"]
    columns = [["variant", *(label_of(row, several) for row in rows)]]
    tail = [
        ["seconds", *(clock(row["seconds"]["mean"]) for row in rows)],
        ["shared", *(f"{row['shared']}/{row['nodes']}" for row in rows)],
    ]
    room = width - sum(2 + max(map(len, column)) for column in (*columns, *tail))
    left_out = 0
    for figure in table["figures"]:
        unit = f" {figure['unit']}" if figure["unit"] else ""
        column = [f"{figure['label']}{unit}"]
        for row in rows:
            entry = row["figures"].get(figure["label"], {})
            difference = ""
            if "difference" in entry:
                within = entry["exceeds"] is False and entry["difference"]
                difference = ("  ≈" if within else "  ") + signed(entry["difference"])
            column.append(text_of(entry) + difference)
        need = 2 + max(map(len, column))
        if need <= room:
            room -= need
            columns.append(column)
        else:
            left_out += 1
    columns += tail
    typer.echo("")
    for index in range(len(rows) + 1):
        cells = [column[index] for column in columns]
        widths = [max(map(len, column)) for column in columns]
        line = "  ".join(
            cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(cells, widths, strict=True))
        )
        typer.echo(line.rstrip())
        if index and rows[index - 1]["state"] != "done":
            typer.echo(f"    {rows[index - 1]['state']}: {rows[index - 1]['reason']}")
    notes = [f"{left_out} more figures in sweep.csv"] if left_out else []
    if any(len(row["repeats"]) > 1 for row in rows):
        notes.append("± over seeds, ≈ within the spread")
    counts = table["nodes"]
    notes.append(f"{counts['from_store']} nodes from the store, {counts['run']} run, {clock(table['seconds'] or 0.0)}")
    typer.echo("\n  " + "; ".join(notes))


def _known(only: list[str] | None, file: Path, files: Sequence[Path]) -> list[str] | None:
    """The names of --only that a file knows; each must be known to one of them."""
    if only is None or len(files) == 1:
        return only
    names = {other: variant_names(other) for other in files}
    known = {name for found in names.values() for name in found}
    return [name for name in only if name in names[file] or name not in known]


def _label(file: str, variant: CheckedVariant, several: bool) -> str:
    name = f"{file}/{variant.name}" if several else variant.name
    return name if variant.repeat == 1 else f"{name}#{variant.repeat}"


def _short(path: Path) -> str:
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
