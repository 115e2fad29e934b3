"""Unrolling `repeat` blocks and turning `@node.port` into links between full names.

Round r of the node `refine` in the block `rounds` becomes `rounds[r].refine`, r = 1, 2, ... Inside a block the short
names of its own nodes come first, then those of the enclosing blocks; `@carry.x` is the value carried into the
round; outside, `@rounds.x` is the value after the last round (the first carried value where `repeat` is 0).
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exmesh_graph.graph.declare.ports import Port
from exmesh_graph.graph.language.params import Declared
from exmesh_graph.graph.language.parts import MAX_COPIED, Lost, Part, declare_part
from exmesh_graph.graph.language.spec import (
    BLOCK_KEYS,
    Tree,
    Value,
    _check_keys,
    _mapping,
    substitute,
)
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where, fail, nearest

MAX_ROUNDS = 1000
MAX_NODES = 5000
MAX_BLOCKS = 10_000


@dataclass(frozen=True)
class Link:
    """An output port of a node, by full names; no port for a component."""

    node: str
    port: str

    def __str__(self) -> str:
        return f"@{self.node}.{self.port}" if self.port else f"@{self.node}"


ABSENT = Link("", "")  # an optional input that the user of a sub-graph left out


class Broken:
    """Stands where a link could not be understood; the problem was noted."""


@dataclass(frozen=True)
class NodeSpec:
    """A node as written: values of `fields` are still unchecked; links are Link objects."""

    name: str
    type: str
    fields: Mapping[str, Value]
    where: Where
    seed: int
    seeded: Where | None = None


@dataclass(frozen=True)
class Graph:
    """An expanded graph: nodes by full name in the order of the file; `given` are the inputs of its sub-graphs."""

    name: str
    file: Path
    nodes: Mapping[str, NodeSpec]
    outputs: Mapping[str, Value]
    params: Mapping[str, Any]
    declared: Mapping[str, Declared] = field(default_factory=dict)
    given: tuple[tuple[str, Port, Link, Where], ...] = ()


@dataclass
class _Scope:
    """Names that see each other. `root` is the prefix of the file they stand in, `outer` the rounds it is used in."""

    params: Mapping[str, Value]
    seed: int
    prefix: str = ""
    parent: _Scope | None = None
    rounds: tuple[int, ...] = ()
    nodes: dict[str, str | _Block | Part | Lost] = field(default_factory=dict)
    block: _Block | None = None
    part: Part | None = None
    root: str = ""
    outer: tuple[int, ...] = ()
    files: tuple[Path, ...] = ()

    def chain(self) -> Iterator[_Scope]:
        scope: _Scope | None = self
        while scope is not None:
            yield scope
            scope = scope.parent


class _Block:
    """One unrolled repeat: knows what each round carries in, and what comes out in the end."""

    def __init__(self, name: str, entry: Map, count: int, outer: _Scope, work: _Expansion) -> None:
        self.name, self.entry, self.count, self.outer, self.work = name, entry, count, outer, work
        self.carry = _mapping(entry, "carry", work.problems)
        self.next = _mapping(entry, "next", work.problems)
        self.scopes: list[_Scope] = []
        self.known: dict[tuple[int, str], Link | None] = {}
        self.busy: set[tuple[int, str]] = set()
        for key in {**self.carry, **self.next}:
            if (key in self.carry) != (key in self.next):
                where = (self.carry if key in self.carry else self.next).lines[key]
                lacks = "next" if key in self.carry else "carry"
                work.problems.add("repeat", where, f"{name}: {key!r} is missing in {lacks}:")

    def value(self, key: str, where: Where) -> Link | None:
        """The value after the last round."""
        return self.carried(self.count, key, where)

    def carried(self, rounds_done: int, key: str, where: Where) -> Link | None:
        """The value of `key` after `rounds_done` rounds."""
        if key not in self.carry or key not in self.next:
            if (key in self.carry) == (key in self.next):
                names = nearest(key, self.carry) or list(self.carry)
                self.work.problems.add("repeat", where, f"{self.name} carries no {key!r}", nearest=names)
            return None
        for done in range(rounds_done + 1):
            if (done, key) in self.known:
                continue
            self.known[done, key] = None
            self.busy.add((done, key))
            scope, source = (self.outer, self.carry) if done == 0 else (self.scopes[done - 1], self.next)
            self.known[done, key] = self.work.link(source[key], scope, source.lines[key])
            self.busy.discard((done, key))
        if (rounds_done, key) in self.busy:
            self.work.problems.add("cycle", where, f"{self.name}: {key!r} is defined by itself")
        return self.known[rounds_done, key]


@dataclass
class _Expansion:
    tree: Tree
    problems: Problems
    nodes: dict[str, NodeSpec] = field(default_factory=dict)
    pending: list[tuple[str, Map, _Scope]] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    parts: list[tuple[Part, Mapping[str, Port]]] = field(default_factory=list)
    files: dict[Path, Map] = field(default_factory=dict)
    copies: dict[tuple[Path, Where], Map] = field(default_factory=dict)
    budget: list[int] = field(default_factory=lambda: [MAX_COPIED])
    blocks: int = 0

    def declare(self, nodes: Map, scope: _Scope) -> None:
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
            elif "graph" in entry:
                declare_part(self, name, entry, scope)
            else:
                if len(self.pending) >= MAX_NODES:
                    fail("repeat", where, f"the graph unrolls to more than {MAX_NODES} nodes")
                scope.nodes[name] = scope.prefix + name
                self.names.add(scope.prefix + name)
                self.pending.append((scope.prefix + name, entry, scope))

    def _declare_block(self, name: str, entry: Map, scope: _Scope) -> None:
        full = scope.prefix + name
        _check_keys(entry, BLOCK_KEYS, f"the repeat block {full}", self.problems)
        where = entry.lines["repeat"]
        count = substitute(entry["repeat"], scope.params, where, self.problems).value
        for override in self.tree.overrides:
            if override.target == f"{_plain(full)}.repeat":
                count, override.used, where = override.value, True, Where(None)
        if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= MAX_ROUNDS:
            expected = f"a whole number from 0 to {MAX_ROUNDS}"
            self.problems.add("repeat", where, f"{full}: repeat is {count!r}", expected=expected)
            count = 0
        block = _Block(full, entry, count, scope, self)
        scope.nodes[name] = block
        inner = _mapping(entry, "nodes", self.problems)
        for number in range(1, count + 1):
            self.count_block(where)
            params = {
                **scope.params,
                "round": Value(number, where, where.base),
                "rounds": Value(count, where, where.base),
            }
            child = replace(
                scope, params=params, prefix=f"{full}[{number}].", parent=scope, rounds=(*scope.rounds, number),
                nodes={}, block=block, part=None,
            )  # fmt: skip
            block.scopes.append(child)
            self.declare(inner, child)

    def count_block(self, where: Where) -> None:
        """Count a round or a sub-graph, which may hold no nodes."""
        self.blocks += 1
        if self.blocks > MAX_BLOCKS:
            fail("repeat", where, f"the graph unrolls to more than {MAX_BLOCKS} rounds and sub-graphs")

    def finish(self) -> tuple[tuple[str, Port, Link, Where], ...]:
        """Build every declared node; returns the links that sub-graphs were given."""
        for full, entry, scope in self.pending:
            self._node(full, entry, scope)
        given = []
        for part, ports in self.parts:
            for name in part.given:
                link = part.input(name, part.where)
                if link == ABSENT and name in ports and not ports[name].optional:
                    where = part.given[name][1]
                    self.problems.add("maybe-absent", where, f"{part.name} needs {name}, but nothing was given",
                                      expected=str(ports[name]))  # fmt: skip
                elif link not in (None, ABSENT) and name in ports:
                    given.append((part.name, ports[name], link, part.given[name][1]))
        for override in self.tree.overrides:
            if not override.used:
                self._unused(override.target)
        return tuple(given)

    def _node(self, full: str, entry: Map, scope: _Scope) -> None:
        layers = [(entry, False)]
        layers += [(patch, True) for patch in self.round_patches(full, entry, scope)]
        kind: Value | None = None
        replaced = False
        raw: dict[str, tuple[Any, Where, bool]] = {}
        for layer, is_patch in layers:
            if "type" in layer:
                kind = substitute(layer["type"], scope.params, layer.lines["type"], self.problems)
                replaced = replaced or is_patch
            for key, value in layer.items():
                if key not in ("type", "every", "at", "doc"):
                    raw[str(key)] = (value, layer.lines[key], is_patch)
        fields = {}
        for key, (value, where, is_patch) in raw.items():
            found = self.value(value, scope, where)
            fields[key] = Value(found.value, found.where, found.base, replaced and not is_patch)
        kind = self._apply_overrides(full, fields, kind, scope)
        if kind is None or not isinstance(kind.value, str):
            names = "name: {type: data.blender, ...}"
            self.problems.add("graph", entry.where, f"node {full} has no type", expected=names)
            return
        seeded = fields["seed"].where if "seed" in fields else None
        seed = self._seed(full, fields, scope)
        self.nodes[full] = NodeSpec(full, kind.value, fields, entry.where, seed, seeded)

    def round_patches(self, full: str, entry: Map, scope: _Scope) -> Iterator[Map]:
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

    def value(self, value: Any, scope: _Scope, where: Where) -> Value:
        """Substitute parameters; a string that begins with one @ becomes a Link (`@@` is a literal @)."""
        found = substitute(value, scope.params, where, self.problems)
        text = found.value
        if isinstance(text, str) and text.startswith("@@"):
            return Value(text[1:], where, found.base)
        if isinstance(text, str) and text.startswith("@"):
            link = self.link(text, scope, where)
            return Value(None if link == ABSENT else link or Broken(), where, found.base)
        return found

    def link(self, text: Any, scope: _Scope, where: Where) -> Link | None:
        """The link that `@node.port` means in `scope`; None after a problem was noted."""
        text = substitute(text, scope.params, where, self.problems).value
        match = re.fullmatch(r"@([^@\s]*?[^@\s.])(?:\.([A-Za-z_]\w*))?", text) if isinstance(text, str) else None
        if match is None:
            expected = '"@node.port", or "@component"'
            self.problems.add("link", where, f"{text!r} is not a link", expected=expected)
            return None
        node, port = match[1], match[2] or ""
        for level in scope.chain():
            if node == "carry" and level.block is not None:
                return level.block.carried(level.rounds[-1] - 1, port, where)
            if node == "inputs" and level.part is not None:
                return level.part.input(port, where)
            target = level.nodes.get(node)
            if isinstance(target, str):
                return Link(target, port)
            if target is not None:
                return target.value(port, where)
        if node == "carry":
            self.problems.add("link", where, f"{text}: there is no carried value outside a repeat block")
            return None
        if node == "inputs":
            if not self.tree.inputs or scope.root:
                self.problems.add("link", where, f"{text}: this graph declares no inputs")
            return None
        node = scope.root + node
        if f"{node}.{port}" in self.names:  # a component by its full name
            return Link(f"{node}.{port}", "")
        return Link(node, port)

    def overrides_of(self, full: str) -> Iterator[tuple[str, Any]]:
        """(key, value) of every `--set` that concerns a node or sub-graph."""
        for override in self.tree.overrides:
            target, _, key = override.target.rpartition(".")
            if target in (full, _plain(full)):
                override.used = True
                yield key, override.value

    def _apply_overrides(self, full: str, fields: dict[str, Value], kind: Value | None, scope: _Scope) -> Value | None:
        here = Where(None)
        for key, value in self.overrides_of(full):
            if key == "type":
                kind = Value(value, here, here.base)
            else:
                fields[key] = self.value(value, scope, here)
        return kind

    def _unused(self, target: str) -> None:
        node, _, key = target.rpartition(".")
        known = [_plain(name) for name, _, _ in self.pending]
        names = [f"{name}.{key}" for name in nearest(node, known)]
        self.problems.add("set", Where(None), f"--set {target}: there is no node {node!r}", nearest=names)

    def _seed(self, full: str, fields: dict[str, Value], scope: _Scope) -> int:
        seed = self.seed_given(full, fields.pop("seed")) if "seed" in fields else scope.seed
        rounds = (*scope.outer, *scope.rounds)
        if not rounds:
            return seed
        text = ":".join(map(str, (seed, *rounds)))
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1

    def seed_given(self, full: str, given: Value) -> int:
        if isinstance(given.value, int) and not isinstance(given.value, bool) and given.value >= 0:
            return given.value
        self.problems.add("seed", given.where, f"{full}: seed must be a whole number >= 0")
        return 0


def expand(tree: Tree, problems: Problems) -> Graph:
    """Unroll all blocks and resolve all links. Problems are noted, not raised."""
    if tree.inputs:
        names = ", ".join(tree.inputs)
        problems.add("input", tree.inputs.where, f"the graph has inputs ({names}) and can only be used in another",
                     fix=f"{{graph: {tree.file.name}, {next(iter(tree.inputs))}: \"@node.port\", ...}}")  # fmt: skip
    work = _Expansion(tree, problems)
    root = _Scope(tree.params, tree.seed, files=(tree.file.resolve(),))
    try:
        work.declare(tree.nodes, root)
        given = work.finish()
    except RecursionError:
        fail("link", Where(tree.file, 1), "links pass through too many blocks or sub-graphs, one after another")
    outputs = {name: work.value(value, root, tree.outputs.lines[name]) for name, value in tree.outputs.items()}
    params = {name: value.value for name, value in tree.params.items()}
    return Graph(tree.name, tree.file, work.nodes, outputs, params, tree.declared, given)


def _plain(name: str) -> str:
    """`rounds[3].refine` without its round: `rounds.refine`."""
    return re.sub(r"\[\d+\]", "", name)
