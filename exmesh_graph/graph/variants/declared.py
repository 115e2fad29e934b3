"""What a graph file declares beside the graph: `variants`, `matrix` and `repeats`, as a list of rows to run.

    variants:
      direct:    [{connect: pbr.transport, to: "@light.transport"}]
      no_chroma: [{set: pbr.chroma_weight, to: 0}]
      both:      {extends: [direct, no_chroma], doc: Neither., patches: []}
    matrix:
      variant: [base, direct]                       # names of variants
      faces: [2000, 8000]                           # anything that --set can set
      split: {score: [], random: [{set: rounds.split.method, to: random}]}      # named patch lists
      exclude: [{variant: direct, faces: 8000}]
      include: [{variant: no_chroma, faces: 500}]   # values and parameters that no axis has may stand here
    repeats: 3                                      # seeds s, s + 1, s + 2; {count: 3, of: [pbr]}: of these nodes

Rows are the base, every variant that the matrix does not use, and the combinations of the matrix; each as often as
`repeats` says. Their number is bounded.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from exmesh_graph.graph.language.yamlfile import Map, is_whole
from exmesh_graph.graph.problems import GraphErrors, Problems, Where, closest
from exmesh_graph.graph.variants.draft import refuse
from exmesh_graph.graph.variants.patches import operation_of

MAX_VARIANTS = 200
MAX_PATCHES = 2000
MAX_CHAIN = 50
BASE = "base"


@dataclass(frozen=True)
class Row:
    """One graph of a sweep before it is built: its patches, and what the table says about it."""

    name: str
    patches: tuple[Any, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    doc: str = ""


@dataclass(frozen=True)
class Repeats:
    """How often every row runs; `of` names the nodes whose seed changes, all where it is empty."""

    count: int = 1
    of: tuple[str, ...] = ()


def rows_of(top: Map) -> list[Row]:
    """The rows of a merged graph file, the base first. Raises GraphErrors for what cannot be read."""
    named = _variants(top)
    axes, cells = _matrix(top, named)
    rows = {BASE: Row(BASE)} | {name: row for name, row in named.items() if name not in axes.get("variant", {})}
    for cell in cells:
        row = _cell_row(axes, cell)
        rows.setdefault(row.name, row)
    count = repeats_of(top).count
    if len(rows) * count > MAX_VARIANTS:
        where = top.lines.get("matrix", top.lines.get("repeats", top.lines.get("variants", top.where)))
        times = f" in {count} repeats" if count > 1 else ""
        what = f"{len(rows)} variants{times} are more than {MAX_VARIANTS}"
        refuse(where, what, fix="split the sweep over several files")
    return list(rows.values())


def repeats_of(top: Map) -> Repeats:
    """`repeats: n` or `repeats: {count: n, of: [nodes]}`."""
    value = top.get("repeats")
    if value is None:
        return Repeats()
    where = top.lines["repeats"]
    count, of = (value.get("count"), value.get("of", [])) if isinstance(value, Map) else (value, [])
    of = [of] if isinstance(of, str) else of
    if not is_whole(count, 1, MAX_VARIANTS):
        refuse(where, f"repeats is {count!r}", expected=f"a whole number from 1 to {MAX_VARIANTS}")
    unknown = [key for key in value if key not in ("count", "of")] if isinstance(value, Map) else []
    if unknown or not isinstance(of, list) or not all(isinstance(name, str) for name in of):
        refuse(where, "repeats cannot be read", expected="repeats: 3 or repeats: {count: 3, of: [node, ...]}")
    return Repeats(count, tuple(of))


def _variants(top: Map) -> dict[str, Row]:
    """Every named variant with the patches of those it extends before its own."""
    given = top.get("variants")
    if given is None:
        return {}
    if not isinstance(given, Map):
        refuse(top.lines["variants"], "variants: must be a mapping", expected="variants: {name: [{bypass: node}]}")
    done: dict[str, Row | None] = {}  # None: being built, or faulty
    told = Problems()

    def build(name: str, where: Where, chain: tuple[str, ...]) -> Row:
        if name in chain:
            refuse(where, f"the variants extend each other: {' -> '.join([*chain, name])}")
        if len(chain) >= MAX_CHAIN:
            refuse(where, f"variants extend each other more than {MAX_CHAIN} deep")
        if name not in given:
            refuse(where, f"there is no variant {name!r}", near=closest(name, map(str, given)))
        if name not in done:
            done[name], here = None, given.lines[name]
            bases, doc, patches = _entry(given[name], here, name)
            before = [p for base in bases for p in build(base, here, (*chain, name)).patches]
            if len(before) + len(patches) > MAX_PATCHES:
                refuse(here, f"the variant {name} has more than {MAX_PATCHES} patches", fix="extend fewer variants")
            done[name] = Row(name, (*before, *patches), {"variant": name}, doc)
        row = done[name]
        if row is None:
            raise GraphErrors([])  # told already
        return row

    for name in given:
        where = given.lines[name]
        with told.caught():
            if not isinstance(name, str) or name == BASE or any(c in name for c in "/:#,= \t"):
                what = f"{name!r} cannot name a variant" + (": it is the unchanged graph" if name == BASE else "")
                refuse(where, what, expected="a word without blanks and / : # , =")
            if given[name] is not None:  # null removes what a base file declared
                build(name, where, ())
    told.raise_if_any()
    return {name: row for name in given if (row := done.get(name)) is not None}


def _entry(entry: Any, where: Where, name: str) -> tuple[list[str], str, list[Any]]:
    """(variants extended, doc, patches) of `[patches]` or `{extends, doc, patches}`."""
    bases: Any = []
    doc = ""
    if isinstance(entry, Map):
        known = ("extends", "doc", "patches")
        for key in entry:
            if key not in known:
                fix = f"{name}: [{{{key}: ...}}], a list"
                refuse(entry.lines[key], f"a variant has no key {key!r}", near=closest(key, known), fix=fix)
        bases, doc = entry.get("extends", []), str(entry.get("doc", "")).strip()
        entry = entry.get("patches", [])
    bases = [bases] if isinstance(bases, str) else bases
    if not isinstance(entry, list) or not isinstance(bases, list) or not all(isinstance(b, str) for b in bases):
        refuse(where, f"the variant {name} must be a list of patches", expected=f"{name}: [{{bypass: rounds.merge}}]")
    told = Problems()
    for patch in entry:
        with told.caught():
            operation_of(patch, where)
    told.raise_if_any()
    return bases, doc, entry


Axes = dict[str, dict[str, tuple[Any, tuple[Any, ...]]]]
"""axis -> {label: (value shown in the table, patches)}"""


def _matrix(top: Map, named: Mapping[str, Row]) -> tuple[Axes, list[dict[str, str]]]:
    matrix = top.get("matrix")
    if matrix is None:
        return {}, []
    where = top.lines["matrix"]
    if not isinstance(matrix, Map):
        refuse(where, "matrix: must be a mapping", expected="matrix: {faces: [2000, 8000]}")
    axes: Axes = {}
    for axis, values in matrix.items():
        if axis not in ("include", "exclude"):
            axes[str(axis)] = dict(_axis(str(axis), values, matrix.lines[axis], named))
    if math.prod(len(labels) for labels in axes.values()) > 10 * MAX_VARIANTS:
        refuse(where, f"the matrix has more than {10 * MAX_VARIANTS} combinations", fix="shorten its axes")
    cells = [dict(zip(axes, labels, strict=True)) for labels in itertools.product(*axes.values())] if axes else []
    for rule in _rules(matrix, "exclude"):
        wanted = _labels(axes, rule)
        kept = [cell for cell in cells if any(cell[axis] != label for axis, label in wanted.items())]
        if len(kept) == len(cells):
            refuse(rule.where, f"exclude matches no combination: {dict(rule)!r}")
        cells = kept
    for rule in _rules(matrix, "include"):
        for axis, value in rule.items():
            if _text(value) not in axes.get(str(axis), {}) and not isinstance(matrix.get(axis), Map):
                axes.setdefault(str(axis), {}).update(_axis(str(axis), [value], rule.where, named))
        cells.append(_labels(axes, rule))
    return axes, cells


def _axis(
    axis: str, values: Any, where: Where, named: Mapping[str, Row]
) -> Iterator[tuple[str, tuple[Any, tuple[Any, ...]]]]:
    def patches_of(name: str, where: Where) -> tuple[Any, ...]:
        if name != BASE and name not in named:
            refuse(where, f"there is no variant {name!r}", near=closest(name, [*named, BASE]))
        return named[name].patches if name != BASE else ()

    if not isinstance(values, Map | list) or not values:
        expected = f"{axis}: [value, ...] for a parameter, {axis}: {{label: [patches], ...}} for named patch lists"
        refuse(where, f"the axis {axis} has no values", expected=expected)
    if isinstance(values, Map):
        for label, patches in values.items():
            there = values.lines[label]
            by_name = isinstance(patches, str)
            listed = patches_of(patches, there) if by_name else tuple(_entry(patches, there, str(label))[2])
            yield str(label), (str(label), listed)
        return
    for value in values:
        label = _text(value)
        if axis == "variant":
            yield label, (label, patches_of(label, where))
        elif isinstance(value, Map | list):
            refuse(where, f"the axis {axis} holds {value!r}", expected="numbers, words, true or false",
                   fix=f"{axis}: {{label: [{{set: {axis}, to: ...}}]}}")  # fmt: skip
        else:
            yield label, (value, (setting(axis, value, where),))


def _labels(axes: Axes, rule: Map) -> dict[str, str]:
    """The labels of the values in a rule, by axis."""
    for axis, value in rule.items():
        if axis not in axes:
            refuse(rule.where, f"the matrix has no axis {axis!r}", near=closest(axis, axes))
        if _text(value) not in axes[axis]:
            refuse(rule.where, f"the axis {axis} has no {value!r}", near=list(axes[axis]))
    return {axis: _text(value) for axis, value in rule.items()}


def _rules(matrix: Map, key: str) -> list[Map]:
    rules: Any = matrix.get(key, [])
    if not isinstance(rules, list) or not all(isinstance(rule, Map) and rule for rule in rules):
        refuse(matrix.lines[key], f"{key}: is a list of mappings", expected=f"{key}: [{{axis: value}}]")
    return rules


def _cell_row(axes: Axes, cell: Mapping[str, str]) -> Row:
    words, settings = [], {}
    patches: list[Any] = []
    for axis, label in cell.items():
        settings[axis], more = axes[axis][label]
        patches += more
        if (axis, label) != ("variant", BASE):
            words.append(label if axis == "variant" else f"{axis}={label}")
    return Row(",".join(words) or BASE, tuple(patches), settings)


def setting(target: str, value: Any, where: Where) -> Map:
    patch = Map(where)
    patch.put("set", target, where)
    patch.put("to", value, where)
    return patch


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return "null" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
