"""Unrolling `repeat` blocks and sub-graphs into nodes with full names, and `@node.port` into links between these."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.ports import Port, link_form
from exmesh_graph.graph.language.links import ABSENT, Block, Link, Links, Part, Passed, Scope
from exmesh_graph.graph.language.params import Declared
from exmesh_graph.graph.language.parts import PartFiles, input_ports
from exmesh_graph.graph.language.spec import BLOCK_KEYS, Tree, Value, check_keys, mapping_in, substitute, tree_of
from exmesh_graph.graph.language.yamlfile import Limits, Map, is_whole, raising
from exmesh_graph.graph.problems import Problems, Where, closest, fail, nearest, without_rounds


@dataclass(frozen=True)
class NodeSpec:
    """A node as written: values of `fields` are still unchecked; links are Link objects."""

    name: str
    type: str
    fields: Mapping[str, Value]
    where: Where
    seed: int
    seeded: Value | None = None
    each: Value | None = None
    limits: tuple[Value, ...] = ()  # those of the graph, its own


@dataclass(frozen=True)
class Unrolled:
    """An expanded graph: nodes by full name in the order of the file; `given` are the inputs of its sub-graphs."""

    name: str
    file: Path
    nodes: Mapping[str, NodeSpec]
    outputs: Mapping[str, Value]
    params: Mapping[str, Any]
    declared: Mapping[str, Declared] = field(default_factory=dict)
    given: tuple[tuple[str, Port, Link, Where], ...] = ()
    run_all: bool = False


def expand(tree: Tree, problems: Problems) -> Unrolled:
    """Unroll all blocks and resolve all links. Problems are noted, not raised."""
    if tree.inputs:
        names = ", ".join(tree.inputs)
        problems.add("input", tree.inputs.where, f"the graph has inputs ({names}) and can only be used in another",
                     fix=f"{{graph: {tree.file.name}, {next(iter(tree.inputs))}: \"@node.port\", ...}}")  # fmt: skip
    work = _Expansion(tree, problems, Links(tree, problems), PartFiles(problems))
    root = Scope(tree.params, tree.seed, files=(tree.file.resolve(),))
    try:
        work.declare(tree.nodes, root)
        given = work.finish()
    except RecursionError:
        fail("link", Where(tree.file, 1), "links pass through too many blocks or sub-graphs, one after another")
    outputs = {name: work.links.value(value, root, tree.outputs.lines[name]) for name, value in tree.outputs.items()}
    params = {name: value.value for name, value in tree.params.items()}
    return Unrolled(tree.name, tree.file, work.nodes, outputs, params, tree.declared, given, tree.run_all)


Written = dict[str, tuple[Any, Where, int]]
"""{key of an entry: (value, where it stands, 0 for the entry itself, more for settings of single rounds)}"""
SET = 1000  # the layer of --set


@dataclass
class _Expansion:
    tree: Tree
    problems: Problems
    links: Links
    files: PartFiles
    nodes: dict[str, NodeSpec] = field(default_factory=dict)
    pending: list[tuple[str, Map, Scope]] = field(default_factory=list)
    parts: list[tuple[Part, Mapping[str, Port]]] = field(default_factory=list)
    blocks: int = 0
    most: Limits = field(default_factory=Limits.here)

    def declare(self, nodes: Map, scope: Scope) -> None:
        """Give every node its full name before any link is resolved, so that links may point forwards."""
        for name, entry in nodes.items():
            where = nodes.lines[name]
            if not isinstance(name, str):
                continue
            if name in ("carry", "inputs"):
                self.problems.add("name", where, f"a node cannot be called {name!r}")
            if not isinstance(entry, Map):
                self.problems.add("graph", where, f"node {name} must be a mapping", expected="{type: ..., ...}")
            elif "repeat" in entry:
                self._declare_block(name, entry, scope)
            elif passed := self._bypassed(scope.prefix + name, entry, scope):
                scope.nodes[name] = self.links.passed[passed.name] = passed
            elif "graph" in entry:
                scope.nodes[name] = self._declare_part(scope.prefix + name, entry, scope)
            else:
                if len(self.pending) >= self.most.nodes:
                    what = f"the graph unrolls to more than {self.most.nodes} nodes"
                    fail("repeat", where, what, fix=raising("nodes"))
                scope.nodes[name] = scope.prefix + name
                self.links.names.add(scope.prefix + name)
                self.pending.append((scope.prefix + name, entry, scope))

    def _bypassed(self, full: str, entry: Map, scope: Scope) -> Passed | None:
        """What stands for a node that is left out, in this round at least: `bypass: {output: input}`."""
        if not entry.keys() & {"bypass", "every", "at"}:
            return None
        written = self._written(full, entry, scope)
        through, where, _ = written.get("bypass", (None, entry.where, 0))
        if through is None:
            return None
        if not isinstance(through, Map) or any(str(port) not in written for port in through.values()):
            what = f"{full}: bypass maps outputs to inputs that are linked, not {through!r}"
            self.problems.add("bypass", where, what, expected="bypass: {state: state}, or null")
            through = Map(where)
        return Passed(full, {str(out): written[str(port)][:2] for out, port in through.items()}, scope, self.links)

    def _declare_block(self, name: str, entry: Map, scope: Scope) -> None:
        full = scope.prefix + name
        check_keys(entry, BLOCK_KEYS, f"the repeat block {full}", self.problems)
        where = entry.lines["repeat"]
        count = substitute(entry["repeat"], scope.params, where, self.problems).value
        for override in self.tree.overrides:
            if override.target == f"{without_rounds(full)}.repeat":
                count, override.used, where = override.value, True, Where(None)
        if not is_whole(count, 0, self.most.rounds):
            expected = f"a whole number from 0 to {self.most.rounds}; {raising('rounds')}"
            self.problems.add("repeat", where, f"{full}: repeat is {count!r}", expected=expected)
            count = 0
        scope.nodes[name] = block = Block(full, entry, count, scope, self.links)
        inner = mapping_in(entry, "nodes", self.problems)
        for number in range(1, count + 1):
            self._count_block(where)
            counters = {"round": Value(number, where, where.base), "rounds": Value(count, where, where.base)}
            child = replace(
                scope, params={**scope.params, **counters}, prefix=f"{full}[{number}].", parent=scope,
                rounds=(*scope.rounds, number), nodes={}, block=block, part=None,
            )  # fmt: skip
            block.scopes.append(child)
            self.declare(inner, child)

    def _declare_part(self, full: str, entry: Map, scope: Scope) -> Part | None:
        """Load the file that `graph:` names and declare its nodes; None where it cannot be used."""
        where = entry.lines["graph"]
        self._count_block(where)
        self.links.names.add(full)
        written = self._written(full, entry, scope)
        source, place, _ = written.pop("graph")
        patches, _ = written.pop("nodes", (None,))[0], written.pop("bypass", None)
        if isinstance(source, Map):  # a copy of a file that patches changed
            path, merged = source.where.file or self.tree.file, source
        else:
            found = self.files.path(substitute(source, scope.params, place, self.problems), place, scope.files)
            if found is None:
                return None
            path, merged = found, self.files.merged(found, where, patches)
        inputs, known = mapping_in(merged, "inputs", self.problems), mapping_in(merged, "params", self.problems)
        links: dict[str, tuple[Any, Where]] = {}
        given: dict[str, Value] = {}
        seed = scope.seed
        for key, (value, place, _) in written.items():
            if key in inputs:
                links |= {} if value is None else {key: (value, place)}
            elif key in known:
                given[key] = self._part_param(f"{full}: {key}", substitute(value, scope.params, place, self.problems))
            elif key == "seed":
                seed = self._seed_given(full, substitute(value, scope.params, place, self.problems))
            else:
                what = f"{full}: {path.name} has no input or parameter {key!r}"
                self.problems.add("unknown-parameter", place, what, nearest=closest(key, [*inputs, *known]))
        tree = tree_of(merged, path, (), self.problems, given)
        part = Part(full, tree, links, scope, self.links, entry.where)
        part.scope = replace(
            scope, params=tree.params, seed=seed, prefix=f"{full}.", parent=None, rounds=(), nodes={}, block=None,
            part=part, root=f"{full}.", outer=(*scope.outer, *scope.rounds), files=(*scope.files, path),
        )  # fmt: skip
        ports = input_ports(tree, self.problems)
        for port in ports.values():
            if not port.optional and port.name not in links:
                self.problems.add(
                    "missing-port", entry.where, f"{full}: the input {port.name} of {path.name} is not connected",
                    expected=str(port), fix=f"{port.name}: {link_form(port)}",
                )  # fmt: skip
        self.parts.append((part, ports))
        self.declare(tree.nodes, part.scope)
        return part

    def _part_param(self, what: str, given: Value) -> Value:
        """A parameter's value; `@@` stands for a literal `@`, as in nodes."""
        if isinstance(given.value, str) and given.value.startswith("@"):
            if not given.value.startswith("@@"):
                self.problems.add("link", given.where, f"{what} is a parameter of the sub-graph, not an input")
            return replace(given, value=given.value[1:])
        return given

    def _count_block(self, where: Where) -> None:
        """Count a round or a sub-graph, which may hold no nodes."""
        self.blocks += 1
        if self.blocks > self.most.blocks:
            what = f"the graph unrolls to more than {self.most.blocks} rounds and sub-graphs"
            fail("repeat", where, what, fix=raising("blocks"))

    def finish(self) -> tuple[tuple[str, Port, Link, Where], ...]:
        """Build every declared node; returns the links that sub-graphs were given."""
        for full, entry, scope in self.pending:
            self._node(full, entry, scope)
        given = []
        for part, ports in self.parts:
            for name, (_, where) in part.given.items():
                link = part.input(name, part.where)
                if name not in ports or link is None:
                    continue
                if link == ABSENT and not ports[name].optional:
                    self.problems.add("maybe-absent", where, f"{part.name} needs {name}, but nothing was given",
                                      expected=str(ports[name]))  # fmt: skip
                elif link != ABSENT:
                    given.append((part.name, ports[name], link, where))
        for override in self.tree.overrides:
            if not override.used:
                node, _, key = override.target.rpartition(".")
                near = nearest(node, [without_rounds(name) for name, _, _ in self.pending])
                what = f"--set {override.target}: there is no node {node!r}"
                self.problems.add("set", Where(None), what, nearest=[f"{name}.{key}" for name in near])
        return tuple(given)

    def _node(self, full: str, entry: Map, scope: Scope) -> None:
        written = self._written(full, entry, scope)
        written.pop("bypass", None)  # null, in this round
        text, where, replaced = written.pop("type", (None, entry.where, 0))
        kind = substitute(text, scope.params, where, self.problems)
        fields = {}
        for key, (value, where, layer) in written.items():
            taken_over = 0 < replaced < SET and layer == 0
            fields[key] = replace(self.links.value(value, scope, where), inherited=taken_over, layer=layer)
        if not isinstance(kind.value, str):
            names = "name: {type: data.blender, ...}"
            self.problems.add("graph", entry.where, f"node {full} has no type", expected=names)
            return
        seeded, each, own = (fields.pop(key, None) for key in ("seed", "each", "limits"))
        shared = substitute(self.tree.limits, self.tree.params, self.tree.limits.where, self.problems)
        seed = scope.seed if seeded is None else self._seed_given(full, seeded)
        rounds = (*scope.outer, *scope.rounds)
        if rounds:
            text = ":".join(map(str, (seed, *rounds)))
            seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1
        limits = (shared, own) if own else (shared,)
        self.nodes[full] = NodeSpec(full, kind.value, fields, entry.where, seed, seeded, each, limits)

    def _written(self, full: str, entry: Map, scope: Scope) -> Written:
        """What an entry says in a round, and `--set` of it."""
        written: Written = {}
        for number, layer in enumerate((entry, *self._round_patches(full, entry, scope))):
            for key, value in layer.items():
                if key not in ("every", "at", "doc"):
                    written[str(key)] = value, layer.lines[key], number
        for override in self.tree.overrides:
            target, _, key = override.target.rpartition(".")
            if target in (full, without_rounds(full)):
                override.used = True
                written[key] = override.value, Where(None), SET
        return written

    def _round_patches(self, full: str, entry: Map, scope: Scope) -> Iterator[Map]:
        for key in ("every", "at"):
            if key not in entry:
                continue
            where, patches = entry.lines[key], entry[key]
            if not scope.rounds:
                self.problems.add("repeat", where, f"{full}: {key}: is for nodes inside a repeat block")
                continue
            if not isinstance(patches, Map):
                self.problems.add("repeat", where, f"{full}: {key}: maps rounds to settings", expected="{4: {...}}")
                continue
            for number in sorted(patches, key=lambda n: (str(type(n)), n)):
                patch = patches[number]
                if not isinstance(number, int) or number < 1 or not isinstance(patch, Map):
                    self.problems.add(
                        "repeat", patches.lines[number], f"{full}: {key}: {number!r} is not usable",
                        expected="a round number from 1 and a mapping of settings",
                    )  # fmt: skip
                elif scope.rounds[-1] == number or (key == "every" and scope.rounds[-1] % number == 0):
                    yield patch

    def _seed_given(self, full: str, given: Value) -> int:
        if is_whole(given.value, 0):
            return given.value
        self.problems.add("seed", given.where, f"{full}: seed must be a whole number >= 0")
        return 0
