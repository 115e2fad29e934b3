""" "Compare with and without": marked nodes, wires and parameters as the variants of a sweep."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import ExmeshError, GraphError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, without_rounds
from exmesh_graph.graph.run.plan import plan as steps_of
from exmesh_graph.graph.variants.checked import CheckedVariant, check_variants
from exmesh_graph.graph.variants.compare import merge
from exmesh_graph.graph.variants.draft import Draft, is_block, is_part
from exmesh_graph.studio.document import Document
from exmesh_graph.studio.edits import Op
from exmesh_graph.studio.values import edit_place, mapped, plain

MOST = 32
"""Things that may be marked."""


@dataclass(frozen=True)
class Without:
    """The graph without one thing: how, and by which patches; `refused` where there is no sound way."""

    name: str
    of: str
    how: str
    patches: tuple[Op, ...] = ()
    why: str = ""

    def as_json(self) -> dict[str, Any]:
        return {"name": self.name, "of": self.of, "how": self.how, "patches": list(self.patches), "why": self.why}


def without_each(document: Document, marked: Sequence[str]) -> list[Without]:
    """A variant for each marked node, input (`sum.b`) or parameter (`pbr.chroma_weight`), checked as a graph is."""
    if not marked or len(marked) > MOST or not all(isinstance(one, str) for one in marked):
        raise GraphError(f"{len(marked)} things are marked", expected=f"1 to {MOST} nodes, inputs or parameters")
    with document.lock:
        names: set[str] = set()
        return [_without(document, without_rounds(one), names) for one in dict.fromkeys(marked)]


def study_tree(document: Document, variants: Mapping[str, Sequence[Op]], repeats: int) -> Map:
    """The open graph with its edits as a merged file that declares these variants and nothing else."""
    if not 1 <= repeats <= 50:
        raise GraphError(f"{repeats} repeats", expected="1 to 50")
    top = document.judged().top.copy()
    for key in ("variants", "matrix", "repeats", "extends"):
        top.pop(key, None)
    where = edit_place(document.folder, 1)
    top.put("variants", mapped({name: list(patches) for name, patches in variants.items()}, where), where)
    if repeats > 1:
        top.put("repeats", repeats, where)
    return top


def study_plan(document: Document, top: Map, store: Store) -> dict[str, Any]:
    """What a sweep of a merged file would run, variant by variant. Raises GraphErrors with the faults of all."""
    with document.session.reading(document.store):
        rows = check_variants(document.file, (), document.packs, top=top)
    merged = merge(((_label(row), row.checked) for row in rows), name=f"{top.get('name', 'graph')}-sweep")
    steps = {step.name: step.state for step in steps_of(merged.checked, store)}
    seen: set[str] = set()
    told = []
    for member in merged.members:
        names = set(member.names.values())
        counts = {state: sum(steps[name] == state for name in names) for state in ("hit", "run", "unknown")}
        told.append({"name": member.label, "nodes": len(names), "shared": len(names & seen), "counts": counts})
        seen |= names
    return {"variants": told, "nodes": sum(len(m.names) for m in merged.members), "distinct": len(steps)}


def study_lines(variants: Iterable[Without]) -> dict[str, list[Op]]:
    """{name: patches} of those that have a sound way."""
    return {one.name: list(one.patches) for one in variants if one.how != "refused"}


def _without(document: Document, target: str, names: set[str]) -> Without:
    name = "no_" + re.sub(r"\W+", "_", target.rpartition(".")[2] or target)
    while name in names:
        name += "_"
    names.add(name)
    why = ""
    for how, ops in _ways(document, target):
        try:
            after = document.after(ops)
            faults = document.judge_of(after).faults
        except (GraphErrors, GraphError) as error:
            why = why or (error.problems[0].what if isinstance(error, GraphErrors) and error.problems else error.what)
            continue
        if not faults:
            return Without(name, target, how, tuple(after[len(document.ops) :]) or tuple(ops))
        why = why or faults[0].what
    return Without(name, target, "refused", why=why or f"there is nothing called {target}")


def _ways(document: Document, target: str) -> list[tuple[str, list[Op]]]:
    """What could be meant by the graph without a thing, the most natural first."""
    draft = Draft(document.judged().top, document.packs)
    entry = draft.entries.get(target)
    if entry is None:
        return _ways_of_key(draft, target)
    if is_block(entry):
        return [("no rounds", [{"set": f"{target}.repeat", "to": 0}])]
    users = [place for place, _ in draft.users(target)]
    freed: list[Op] = [{"disconnect": place.label} for place in users]
    if is_part(entry):
        return [("removed", [*freed, {"remove": target}])]
    kind = draft.kind(entry)
    if kind is not None and kind.component is not None:
        return [("unplugged", freed)]
    return [("bypassed", [{"bypass": target}]), ("removed", [*freed, {"remove": target}])]


def _ways_of_key(draft: Draft, target: str) -> list[tuple[str, list[Op]]]:
    """An optional input is disconnected; a number becomes 0, a switch is turned off."""
    path, _, key = target.rpartition(".")
    entry = draft.entries.get(path)
    kind = draft.kind(entry) if isinstance(entry, Map) else None
    if kind is None:
        return []
    if key in kind.inputs:
        return [("disconnected", [{"disconnect": target}])]
    field = kind.params.model_fields.get(key)
    if field is None:
        return []
    default = plain(None if field.is_required() else field.get_default(call_default_factory=True))
    if isinstance(default, bool):
        return [("off", [{"set": target, "to": False}])]
    return [("zero", [{"set": target, "to": 0}])] if isinstance(default, int | float) else []


def _label(row: CheckedVariant) -> str:
    return row.name if row.repeat == 1 else f"{row.name}#{row.repeat}"


class Refused(ExmeshError):
    """Nothing that was marked can be left out."""

    code = "graph"
