"""Every variant of a graph file, loaded, patched, unrolled and checked; all faults of all variants at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.language.check import Checked, check
from exmesh_graph.graph.language.expand import expand
from exmesh_graph.graph.language.extends import load_merged
from exmesh_graph.graph.language.spec import tree_of
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, Problem, Problems, Where, in_short, nearest
from exmesh_graph.graph.variants.declared import BASE, Repeats, Row, repeats_of, rows_of, setting
from exmesh_graph.graph.variants.draft import Draft, refuse
from exmesh_graph.graph.variants.patches import apply_patches


class CheckedVariant(NamedTuple):
    """A graph of a sweep; `settings` holds the variant or the values of the matrix, `repeat` counts from 1."""

    name: str
    settings: Mapping[str, Any]
    checked: Checked
    repeat: int = 1
    seed: int = 0
    doc: str = ""


def check_variants(
    path: Path, overrides: Iterable[str], packs: Packs, only: Iterable[str] | None = None, *,
    repeats: bool = True, top: Map | None = None,
) -> list[CheckedVariant]:  # fmt: skip
    """The base and every variant that `path` declares, in that order, each with its repeats (or in one, if False).

    `only` keeps the base and the rows of these names; `top` is the merged file where it is at hand. Raises GraphErrors
    with the faults of all rows.
    """
    path, sets = path.absolute(), list(overrides)
    top = _load(path) if top is None else top
    rows, times = rows_of(top), repeats_of(top) if repeats else Repeats()
    if only is not None:
        chosen = list(only)
        for name in chosen:
            _row_named(name, rows)
        rows = [row for row in rows if row.name == BASE or row.name in chosen]
    graphs: list[CheckedVariant] = []
    faults: dict[tuple[str, str, str], tuple[Problem, list[str]]] = {}
    for row in rows:
        try:
            graphs += _built(top, path, sets, row, times, packs)
        except GraphErrors as error:
            for problem in error.problems:
                key = (problem.code, str(problem.where), problem.what)
                faults.setdefault(key, (problem, []))[1].append(row.name)
    if faults:
        raise GraphErrors([_attributed(problem, names) for problem, names in faults.values()])
    return graphs


def check_variant(path: Path, overrides: Iterable[str], packs: Packs, name: str, *, top: Map | None = None) -> Checked:
    """One variant of a graph file, with the seed that the file or the overrides give; `top` as in check_variants."""
    path = path.absolute()
    top = _load(path) if top is None else top
    row = _row_named(name, rows_of(top))
    try:
        return _built(top, path, list(overrides), row, Repeats(), packs)[0].checked
    except GraphErrors as error:
        raise GraphErrors([_attributed(problem, [name]) for problem in error.problems]) from None


def variant_names(path: Path) -> list[str]:
    """The base and all variants that a graph file declares."""
    return [row.name for row in rows_of(_load(path.absolute()))]


def _load(path: Path) -> Map:
    problems = Problems()
    top = load_merged(path, problems)
    problems.raise_if_any()
    return top


def _row_named(name: str, rows: list[Row]) -> Row:
    by_name = {row.name: row for row in rows}
    if name not in by_name:
        near = nearest(name, by_name) or list(by_name)[:8]
        fix = "" if len(rows) > 1 else "declare variants: or matrix: in the graph file"
        refuse(Where(None), f"the graph has no variant {name!r}", near=near, fix=fix)
    return by_name[name]


def _built(
    top: Map, path: Path, overrides: list[str], row: Row, repeats: Repeats, packs: Packs
) -> list[CheckedVariant]:
    """One row in all its repeats."""
    patched = apply_patches(top, row.patches, packs)
    graphs = []
    for index in range(repeats.count):
        problems = Problems()
        tree = tree_of(patched, path, overrides, problems)
        seed = tree.seed + index
        if index and repeats.of:
            where = top.lines["repeats"]
            names = [name for name in repeats.of if row.name == BASE or _has_node(patched, name, packs)]
            again = apply_patches(patched, [setting(f"{name}.seed", seed, where) for name in names], packs)
            tree = tree_of(again, path, overrides, problems)
        elif index:
            tree.seed = seed
        checked = check(expand(tree, problems), packs, problems)
        name = checked.name if row.name == BASE else f"{checked.name}-{row.name}"
        checked = replace(checked, name=name, variant="" if row.name == BASE else row.name)
        graphs.append(CheckedVariant(row.name, row.settings, checked, index + 1, seed, row.doc))
    return graphs


def _has_node(top: Map, name: str, packs: Packs) -> bool:
    """Whether a merged file has this node, or a sub-graph that may hold it: a variant may have taken it out."""
    draft = Draft(top, packs)
    return name in draft.entries or bool(draft.part_around(name))


def _attributed(problem: Problem, names: list[str]) -> Problem:
    return problem if BASE in names else replace(problem, what=f"variant {in_short(names, 3)}: {problem.what}")
