"""Sweeps: a graph and all variants that it declares, merged so that equal nodes run once, compared in one table."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exmesh_graph.api.arguments import checked_options, file_of, node_names, path_of
from exmesh_graph.api.builder import Graph
from exmesh_graph.api.opening import Folder, Settings, Source, checked_variants, stem_of, texts_of, using
from exmesh_graph.api.planning import counted, counts_of
from exmesh_graph.api.progress import Progress
from exmesh_graph.api.results import NodeRun, Run, UnknownName
from exmesh_graph.api.runs import Resources, RunFailed, command_words, run_checked, tokens_of
from exmesh_graph.api.values import here
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.problems import GraphErrors, Problem, nearest
from exmesh_graph.graph.run.plan import plan
from exmesh_graph.graph.variants.checked import CheckedVariant, variant_names
from exmesh_graph.graph.variants.compare import Merged, merge
from exmesh_graph.graph.variants.declared import rows_of

if TYPE_CHECKING:
    from exmesh_graph.graph.cache.store import Store
    from exmesh_graph.graph.run.runner import Listener
    from exmesh_graph.graph.session import Session

BASE = "base"


@dataclass(frozen=True)
class Study:
    """What a sweep runs: (name of the graph file, variant) in order, and their merged graph."""

    rows: list[tuple[str, CheckedVariant]]
    merged: Merged
    targets: set[str] | None

    @classmethod
    def of(
        cls, graphs: Sequence[Source], sets: list[str], only: list[str] | None, targets: Iterable[str], store: Folder
    ) -> Study:
        """Check all variants of all graphs; the faults of all are raised at once."""
        rows: list[tuple[str, CheckedVariant]] = []
        problems: list[Problem] = []
        graphs = list(dict.fromkeys(graphs))
        stems = [stem_of(graph) for graph in graphs]
        for graph in graphs:
            try:
                chosen = checked_variants(graph, sets, store, only=_known(only, graph, graphs))
                whole = not isinstance(graph, Graph) and stems.count(stem_of(graph)) > 1
                title = str(Path(graph).with_suffix("")) if whole else stem_of(graph)  # type: ignore[arg-type]
                rows += [(title, variant) for variant in chosen if only is None or len(chosen) > 1 or BASE in only]
            except GraphErrors as error:
                problems += [problem for problem in error.problems if problem not in problems]
        if problems:
            raise GraphErrors(problems)
        several = len({title for title, _ in rows}) > 1
        labels = [_label(file, variant, several) for file, variant in rows]
        name = "-".join(dict.fromkeys(stems))
        merged = merge(zip(labels, (variant.checked for _, variant in rows), strict=True), name=f"{name}-sweep")
        return cls(rows, merged, _needed(merged, list(targets)))

    def members(self) -> list[dict[str, Any]]:
        """The variants as plain JSON-like data, for the table."""
        return [
            {"variant": variant.name, "file": file, "repeat": variant.repeat, "seed": variant.seed,
             "settings": dict(variant.settings), "doc": variant.doc, "nodes": dict(member.names)}
            for (file, variant), member in zip(self.rows, self.merged.members, strict=True)
        ]  # fmt: skip

    def __str__(self) -> str:
        names = dict.fromkeys((file, variant.name) for file, variant in self.rows)
        repeats = len(self.rows) // len(names)
        times = f" x {repeats} seeds" if repeats > 1 else ""
        total = sum(len(member.names) for member in self.merged.members)
        return f"{len(names)} variants{times}: {total} nodes, {len(self.merged.checked.nodes)} after sharing"

    def plan(self, store: Store) -> list[str]:
        """What would run, a line for each variant and one for all."""
        steps = {step.name: step.state for step in plan(self.merged.checked, store, self.targets)}
        width = max(len(member.label) for member in self.merged.members)
        seen: set[str] = set()
        lines = []
        for member in self.merged.members:
            names = [name for name in member.names.values() if name in steps]
            new, counts = {*names} - seen, counted(counts_of(steps[name] for name in names))
            seen |= new
            told = f"{len(names)} nodes, {len(new)} not shared with those above: {counts}"
            lines.append(f"{member.label:<{width + 2}}{told}")
        return [*lines, f"{counted(counts_of(steps.values()))} (below a node that must run)"]


class Sweep(Mapping[str, Mapping[str, NodeRun]]):
    """A sweep that was run: `sweep["direct"]["pbr"].asset`, the `table` of figures, and the `page` that shows it.

    Nodes that failed are in `failures`, {name: message}; their variants say so in the table.
    """

    def __init__(self, study: Study, run: Run, failures: Mapping[str, str]) -> None:
        from exmesh_graph.report.sweep.files import write_sweep
        from exmesh_graph.report.sweep.pictures import sweep_pictures
        from exmesh_graph.report.sweep.table import sweep_table

        self.study, self.run, self.failures = study, run, dict(failures)
        self.members = {member.label: member.names for member in study.merged.members}
        self.table: Mapping[str, Any] = sweep_table(run.record, study.members(), run.artifact, self.failures)
        pictures = sweep_pictures(run.record, study.members(), run.artifact)
        self.page: Path = write_sweep(run.folder, self.table, pictures)

    @property
    def folder(self) -> Path:
        return self.run.folder

    def __getitem__(self, label: str) -> Mapping[str, NodeRun]:
        if label not in self.members:
            near = nearest(str(label), self.members) or list(self.members)[:8]
            raise UnknownName(f"the sweep has no variant {label!r}", expected=", ".join(near))
        names = self.members[label]
        return {name: self.run[merged] for name, merged in names.items() if merged in self.run}

    def __iter__(self) -> Any:
        return iter(self.members)

    def __len__(self) -> int:
        return len(self.members)

    def __repr__(self) -> str:
        return f"<sweep {self.run.id}: {self.study}>"


def sweep(
    *graphs: Source,
    set: Settings = None,
    only: Iterable[str] | None = None,
    nodes: Iterable[str] | str | None = None,
    store: Folder = None,
    shared: str | None = None,
    runs: str | os.PathLike[str] = "runs",
    workers: int | None = None,
    backend: str = "local",
    address: str | None = None,
    tokens: Mapping[str, float] | str | None = None,
    keep_going: bool = True,
    progress: Progress = "auto",
    listener: Listener | None = None,
    started: Callable[[Study], Any] | None = None,
    session: Session | None = None,
    **params: Any,
) -> Sweep:
    """Run graphs and all variants that they declare, equal nodes once. `only` names variants; the rest as for ex.run.

    Raises GraphErrors with the faults of all variants, and KeyboardInterrupt as ex.run does; failed nodes do not raise.
    """
    checked_options(workers, tokens, progress, listener)
    if not graphs or not all(stem_of(graph) for graph in graphs):
        raise GraphError("there is no graph to sweep", where=str(here()), expected="a graph, or several")
    with using(session):
        sets = texts_of(set, params)
        chosen = None if only is None else [only] if isinstance(only, str) else list(only)
        targets = node_names(nodes)
        at = Resources(
            store, shared, path_of(runs, "runs", "the path of a folder"), workers, backend, address, tokens_of(tokens)
        )
        study = Study.of(graphs, sets, chosen, targets, store)
        words = command_words(sets, {}, [word for name in chosen or () for word in ("--only", name)])
        words += [word for name in targets for word in ("--node", name)]
        words += [*at.words(), *([] if keep_going else ["--stop"])]
        if started is not None:
            started(study)
        failures: dict[str, str] = {}
        try:
            result = run_checked(
                study.merged.checked, graphs, at, words, verb="sweep", progress=progress, listener=listener,
                report=False, targets=study.targets, overrides=tuple(sets), keep_going=keep_going,
            )  # fmt: skip
        except RunFailed as failure:
            result = failure.run
            failures = {str(record["node"]): str(record["message"]) for record in result.failures}
        return Sweep(study, result, failures)


def _needed(merged: Merged, targets: list[str]) -> set[str] | None:
    """The nodes that named ones need, in all variants; None for all. Raises GraphError for an unknown name."""
    if not targets:
        return None
    known = dict.fromkeys(name for member in merged.members for name in member.names)
    known |= dict.fromkeys(merged.checked.nodes)  # as messages name them: `direct:pbr`
    for target in targets:
        if target not in known:
            near = nearest(target, known) or list(known)[:8]
            raise GraphError(f"no variant has a node {target!r}", where=str(here()), expected=", ".join(near))
    ends = [member.names[t] for member in merged.members for t in targets if t in member.names]
    return merged.checked.needed_for([*ends, *(t for t in targets if t in merged.checked.nodes)])


def _known(only: list[str] | None, graph: Source, graphs: Sequence[Source]) -> list[str] | None:
    """The names of --only that a graph knows; each must be known to one of them."""
    if only is None or len(graphs) == 1:
        return only
    names = {other: _variants_of(other) for other in graphs}
    known = {name for listed in names.values() for name in listed}
    return [name for name in only if name in names[graph] or name not in known]


def _variants_of(graph: Source) -> list[str]:
    return [row.name for row in rows_of(graph.merged())] if isinstance(graph, Graph) else variant_names(file_of(graph))


def _label(file: str, variant: CheckedVariant, several: bool) -> str:
    name = f"{file}/{variant.name}" if several else variant.name
    return name if variant.repeat == 1 else f"{name}#{variant.repeat}"
