"""The open graph: a file, the edits on it with undo and redo, and what the checks say of the result.

The edits are patches; nothing is written until the graph is saved. All that is asked of a document is answered under
its lock, so that two browsers see one state.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.language.check import Checked, check
from exmesh_graph.graph.language.expand import Unrolled, expand
from exmesh_graph.graph.language.extends import load_merged
from exmesh_graph.graph.language.spec import Tree, tree_of
from exmesh_graph.graph.language.yamlfile import Map, every
from exmesh_graph.graph.problems import GraphErrors, Problem, Problems, Where, without_rounds
from exmesh_graph.graph.session import Session
from exmesh_graph.graph.variants.declared import BASE, Row, rows_of
from exmesh_graph.graph.variants.draft import Draft
from exmesh_graph.studio.edits import Op, patched, with_edit
from exmesh_graph.studio.ends import Ends
from exmesh_graph.studio.faults import counted, fault_facts
from exmesh_graph.studio.parameters import graph_parameters
from exmesh_graph.studio.places import Conflict
from exmesh_graph.studio.reading import Reading
from exmesh_graph.studio.typefacts import TypeFacts
from exmesh_graph.studio.values import EDIT, plain

KEPT = 500
"""States that can be gone back to."""


@dataclass(frozen=True)
class Judged:
    """A graph with its edits after the checks: `checked` is None where it has faults."""

    top: Map
    tree: Tree | None
    unrolled: Unrolled | None
    checked: Checked | None
    faults: tuple[Problem, ...]


@dataclass
class Document:
    """`file` as it was read last, and a history of lists of patches; `place` is the one that counts."""

    session: Session
    folder: Path
    file: Path
    store: Path
    variant: str = ""
    history: list[list[Op]] = field(default_factory=lambda: [[]])
    place: int = 0
    revision: int = 1
    lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        self.begun: list[Op] = list(self.history[0])
        self._real = os.path.realpath(self.file)
        self._judged: tuple[list[Op], Judged] | None = None
        self._drawn: tuple[Judged, TypeFacts, dict[str, Any]] | None = None
        self._read()

    # --- state

    @property
    def ops(self) -> list[Op]:
        """The edits that count now."""
        return self.history[self.place]

    @property
    def dirty(self) -> bool:
        return self.ops != self.begun

    @property
    def packs(self) -> Packs:
        return self.session.packs()

    def edit(self, ops: Sequence[Any]) -> None:
        """Put edits on the graph as one step. Raises GraphErrors, and changes nothing, where one is refused."""
        with self.lock:
            self._step(self.after(ops))

    def after(self, ops: Sequence[Any]) -> list[Op]:
        """The list of patches that edits would lead to."""
        with self.lock:
            result, packs = list(self.ops), self.packs
            for op in ops:
                result = with_edit(self.base, result, op, packs, self.folder)
            patched(self.base, result, packs, self.folder)
            return result

    def undo(self) -> bool:
        """Go back one step; whether there was one."""
        return self._go(-1)

    def redo(self) -> bool:
        """Go forward again."""
        return self._go(1)

    def revert(self) -> None:
        """Take all edits away, as one step that can be undone."""
        with self.lock:
            self._step(list(self.begun))

    def reload(self) -> list[Op]:
        """Read the file again; the edits that are no longer possible are taken out and given back."""
        with self.lock:
            self.check_place()
            self._read()
            kept: list[Op] = []
            lost: list[Op] = []
            for op in self.ops:
                try:
                    patched(self.base, [*kept, op], self.packs, self.folder)
                    kept.append(op)
                except GraphErrors:
                    lost.append(op)
            self._step(kept)
            return lost

    def saved(self) -> None:
        """The edits stand in the file now: begin anew from it."""
        with self.lock:
            self.history, self.place, self.begun, self.variant = [[]], 0, [], ""
            self._read()
            self.revision += 1

    def check_place(self) -> None:
        """Raises Conflict where the file became a link to another one since it was opened."""
        if os.path.realpath(self.file) != self._real:
            raise Conflict(
                f"{self.file.name} is a link to another file now", fix="make it a file again, or open another"
            )

    def changed_on_disk(self) -> bool:
        """Whether a file that the graph is made of, those of its sub-graphs too, was written since it was read."""
        with self.lock:
            known = dict(self.stamps)
        return any(_stamp(path) != stamp for path, stamp in known.items())

    # --- what comes of it

    def judged(self, ops: Sequence[Op] | None = None) -> Judged:
        """The graph with its edits, or others, checked."""
        with self.lock:
            wanted = list(self.ops if ops is None else ops)
            if self._judged is None or self._judged[0] != wanted:
                self._judged = wanted, self._judge(wanted)
            return self._judged[1]

    def judge_of(self, ops: Sequence[Op]) -> Judged:
        """The graph with other edits, checked and not remembered."""
        with self.lock:
            return self._judge(ops)

    def facts(self, ops: Sequence[Op] | None = None) -> dict[str, Any]:
        """DOCUMENT of the contract, but for the plan."""
        with self.lock:
            judged, used = self.judged(ops), list(self.ops if ops is None else ops)
            return {
                "revision": self.revision, "file": str(self.file.relative_to(self.folder)) if self._near() else
                str(self.file), "path": str(self.file), "name": str(judged.top.get("name", self.file.stem)),
                "doc": str(judged.top.get("doc") or ""), "variant": self.variant, "variants": self.variants(),
                "folder": str(self.folder), "seed": judged.top.get("seed", 0),
                "params": [] if judged.tree is None else self._params(judged.tree, judged.top),
                **self._shown(judged), "ops": used, "can_undo": self.place > 0,
                "can_redo": self.place + 1 < len(self.history), "dirty": used != self.begun,
                "disk": "changed" if self.changed_on_disk() else "same",
            }  # fmt: skip

    def _shown(self, judged: Judged) -> dict[str, Any]:
        """Nodes, wires and faults of a judged graph: the same for every page that asks, until something changes."""
        if self._drawn is None or self._drawn[0] is not judged or self._drawn[1] is not self.types:
            reading = self.reading(judged)
            nodes = list(reading.nodes())
            names: dict[str, list[str]] = {}
            for name in judged.unrolled.nodes if judged.unrolled is not None else ():
                names.setdefault(without_rounds(name), []).append(name)
            problems = [fault_facts(problem, names or reading.entries, self.folder) for problem in judged.faults]
            counts = counted(problems)
            for node in nodes:
                if (unrolled := names.get(node["id"], [])) != [node["id"]]:
                    node["names"] = unrolled
                if node["id"] in counts:
                    node["problems"] = counts[node["id"]]
            types = self.types.used(node.get("type", "") for node in nodes)
            shown = {"types": types, "nodes": nodes, "wires": list(reading.wires()), "outputs": reading.outputs(),
                     "problems": problems}  # fmt: skip
            self._drawn = judged, self.types, shown
        return self._drawn[2]

    def reading(self, judged: Judged) -> Reading:
        """A judged graph as it is shown."""
        params = {} if judged.tree is None else judged.tree.params
        return Reading(Draft(judged.top, self.packs), self.types, self.folder, self.file, params)

    def ends(self, node: str = "") -> Ends:
        """What may be connected to what, in the file that a node stands in."""
        with self.lock:
            return Ends(self.reading(self.judged()).around(node))

    def variants(self) -> list[dict[str, Any]]:
        """The variants that the file declares."""
        try:
            rows = rows_of(self.base)
        except GraphErrors:
            return []
        return [{"name": r.name, "doc": r.doc, "patches": len(r.patches)} for r in rows if r.name != BASE]

    # --- inside

    def _params(self, tree: Tree, top: Map) -> list[dict[str, Any]]:
        told = graph_parameters(tree)
        before = self.base.get("params") or {}
        for one in told:
            one["set"] = plain((top.get("params") or {}).get(one["name"])) != plain(before.get(one["name"]))
        return told

    def _step(self, ops: list[Op]) -> None:
        if ops != self.ops:
            self.history = [*self.history[: self.place + 1], ops][-KEPT:]
            self.place = len(self.history) - 1
        self.revision += 1

    def _go(self, way: int) -> bool:
        with self.lock:
            if not 0 <= self.place + way < len(self.history):
                return False
            self.place += way
            self.revision += 1
            return True

    def _read(self) -> None:
        """Read the file with all that it extends; one that cannot be read is an empty graph with the reason."""
        problems, began = Problems(), time.time_ns()
        self.unreadable: tuple[Problem, ...] = ()
        self.base = Map(Where(self.file, 1))
        self._judged = None
        self.types = TypeFacts(self.packs)
        try:
            with self.session.reading(self.store):
                self.base = load_merged(self.file, problems)
        except GraphErrors as error:
            self.unreadable = error.problems
        maps = [one for one in every(self.base) if isinstance(one, Map)]
        files = {where.file for one in maps for where in (one.where, *one.lines.values())}
        self.stamps = {path: _stamp(path, began) for path in {self.file, *files} if path is not None}

    def _judge(self, ops: Sequence[Op]) -> Judged:
        packs, problems, began = self.packs, Problems(), time.time_ns()
        if self.unreadable:
            return Judged(self.base, None, None, None, self.unreadable)
        top = patched(self.base, ops, packs, self.folder)
        tree = unrolled = checked = None
        faults: tuple[Problem, ...] = ()
        try:
            with self.session.reading(self.store):
                tree = tree_of(top, self.file, (), problems)
                unrolled = expand(tree, problems)
                checked = check(unrolled, packs, problems)
        except GraphErrors as error:
            faults = error.problems
        except ExmeshError as error:
            faults = (Problem(error.code, Where(self.file, 1), error.what, expected=error.expected, fix=error.fix),)
        for path in {*_parts_named(top), *_files_of(unrolled)}:
            if path is not None and path.name != EDIT and path not in self.stamps:
                self.stamps[path] = _stamp(path, began)
        return Judged(top, tree, unrolled, checked, faults)

    def _near(self) -> bool:
        return self.file.is_relative_to(self.folder)


def _files_of(unrolled: Unrolled | None) -> set[Path | None]:
    """The files that nodes stand in, those of sub-graphs too."""
    return set() if unrolled is None else {spec.where.file for spec in unrolled.nodes.values()}


def _parts_named(top: Map) -> Iterator[Path]:
    """The files that sub-graphs of a graph name, whether they are there or not."""
    for one in every(top):
        if isinstance(one, Map) and isinstance(name := one.get("graph"), str) and "${" not in name:
            yield (one.lines["graph"].base / name).absolute()


def _stamp(path: Path, read: int | None = None) -> int:
    """When a file was written last; 0 where it is gone, -1 where that was since `read`, when its reading began."""
    try:
        stamp = path.stat().st_mtime_ns
    except OSError:
        return 0
    return -1 if read is not None and read <= stamp <= time.time_ns() else stamp


def variant_ops(document_base: Map, name: str) -> list[Op]:
    """The patches of a variant as edits. Raises GraphErrors where there is none of this name."""
    rows: dict[str, Row] = {row.name: row for row in rows_of(document_base)}
    if name not in rows:
        raise ExmeshError(f"the graph has no variant {name!r}", expected=", ".join(rows))
    return [plain(patch) for patch in rows[name].patches]
