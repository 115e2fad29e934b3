"""What a link means: the names that see each other, what repeat blocks carry, what sub-graphs take in and give out.

Round r of the node `refine` in the block `rounds` is `rounds[r].refine`, r = 1, 2, ... Inside a block the short names
of its own nodes come first, then those of the enclosing blocks; `@carry.x` is the value carried into the round;
outside, `@rounds.x` is the value after the last round (the first carried value where `repeat` is 0). Inside a
sub-graph only its own names and `@inputs.x` are seen; outside, `@part.x` is its output x.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exmesh_graph.graph.language.spec import Tree, Value, mapping_in, substitute
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where, closest


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


@dataclass
class Scope:
    """Names that see each other. `root` is the prefix of the file they stand in, `outer` the rounds it is used in.

    `nodes` maps a name to a node's full name, or to a block or sub-graph; to None where its file cannot be used.
    """

    params: Mapping[str, Value]
    seed: int
    prefix: str = ""
    parent: Scope | None = None
    rounds: tuple[int, ...] = ()
    nodes: dict[str, str | Block | Part | Passed | None] = field(default_factory=dict)
    block: Block | None = None
    part: Part | None = None
    root: str = ""
    outer: tuple[int, ...] = ()
    files: tuple[Path, ...] = ()


@dataclass
class Links:
    """Reads the links of a graph; `names`: its nodes and sub-graphs by full names; `passed`: the bypassed ones."""

    tree: Tree
    problems: Problems
    names: set[str] = field(default_factory=set)
    passed: dict[str, Passed] = field(default_factory=dict)

    def value(self, value: Any, scope: Scope, where: Where) -> Value:
        """Substitute parameters; a string that begins with one @ becomes a Link (`@@` is a literal @).

        So do the items of a list; `@rounds[*].x` becomes a list with a link for each round.
        """
        result = substitute(value, scope.params, where, self.problems)
        given = result.value
        several = isinstance(given, list) or (isinstance(given, str) and "[*]" in given)
        items = given if isinstance(given, list) else [given]
        if not any(isinstance(item, str) and item.startswith("@") for item in items):
            return result
        meant = [one for item in items for one in self._meant(item, scope, where)]
        return Value(meant if several else meant[0], where, result.base)

    def _meant(self, item: Any, scope: Scope, where: Where) -> list[Any]:
        """What one item stands for: itself, or links."""
        if not isinstance(item, str) or not item.startswith("@"):
            return [item]
        if item.startswith("@@"):
            return [item[1:]]
        if "[*]" in item:
            return self._in_each_round(item, scope, where)
        link = self.link(item, scope, where)
        return [None if link == ABSENT else link or Broken()]

    def _in_each_round(self, text: str, scope: Scope, where: Where) -> list[Any]:
        """The links that `@rounds[*].x`, a carried value, or `@rounds[*].node.port` stands for."""
        name, _, rest = text[1:].partition("[*].")
        level: Scope | None = scope
        while level is not None and name not in level.nodes:
            level = level.parent
        block = None if level is None else level.nodes[name]
        if not isinstance(block, Block):
            self.problems.add("link", where, f"{text}: there is no repeat block {name!r} here")
            return [Broken()]
        first, dot, _ = rest.partition(".")
        links: list[Any] = []
        for number, inner in enumerate(block.scopes, 1):
            if not dot:
                links.append(block.carried(number, rest, where) or Broken())
            elif first.partition("[")[0] in inner.nodes:
                links += self._meant(f"@{rest}", inner, where)
            else:
                what = f"{text}: the block {name} has no node {first!r}"
                self.problems.add("unknown-node", where, what, nearest=closest(first, inner.nodes))
                return [Broken()]
        return links

    def link(self, text: Any, scope: Scope, where: Where) -> Link | None:
        """The link that `@node.port` means in `scope`; None after a problem was noted."""
        text = substitute(text, scope.params, where, self.problems).value
        match = re.fullmatch(r"@([^@\s]*?[^@\s.])(?:\.([A-Za-z_]\w*))?", text) if isinstance(text, str) else None
        if match is None:
            expected = '"@node.port", or "@component"'
            self.problems.add("link", where, f"{text!r} is not a link", expected=expected)
            return None
        node, port = match[1], match[2] or ""
        level: Scope | None = scope
        while level is not None:
            if node == "carry" and level.block is not None:
                return level.block.carried(level.rounds[-1] - 1, port, where)
            if node == "inputs" and level.part is not None:
                return level.part.input(port, where)
            if node in level.nodes:
                target = level.nodes[node]
                if isinstance(target, str):
                    return Link(target, port)
                return None if target is None else target.value(port, where)
            level = level.parent
        lacks = {"carry": "there is no carried value outside a repeat block", "inputs": "this graph declares no inputs"}
        if node in lacks:
            if node == "carry" or not self.tree.inputs or scope.root:
                self.problems.add("link", where, f"{text}: {lacks[node]}")
            return None
        node = scope.root + node
        if node in self.passed:
            return self.passed[node].value(port, where)
        full = f"{node}.{port}"
        return Link(full, "") if full in self.names else Link(node, port)  # a component by its full name


class _Named:
    """Links under names that are resolved when first asked for, each once."""

    def __init__(self, name: str, links: Links) -> None:
        self.name, self.links, self.problems = name, links, links.problems
        self.known: dict[Any, Link | None] = {}
        self.open: set[Any] = set()

    def resolved(self, key: Any, label: str, text: Any, place: Where, scope: Scope, where: Where) -> Link | None:
        """What `text`, which stands at `place` in `scope`, means; asked for at `where`."""
        if key not in self.known:
            self.known[key] = None
            self.open.add(key)
            self.known[key] = self.links.link(text, scope, place)
            self.open.discard(key)
        elif key in self.open:
            self.problems.add("cycle", where, f"{self.name}: {label} is defined by itself")
        return self.known[key]


class Block(_Named):
    """One unrolled repeat: knows what each round carries in, and what comes out in the end."""

    def __init__(self, name: str, entry: Map, count: int, outer: Scope, links: Links) -> None:
        super().__init__(name, links)
        self.count, self.outer = count, outer
        self.carry = mapping_in(entry, "carry", links.problems)
        self.next = mapping_in(entry, "next", links.problems)
        self.scopes: list[Scope] = []
        self.reached: dict[str, int] = {}  # by key: rounds before are known
        for key in {**self.carry, **self.next}:
            if (key in self.carry) != (key in self.next):
                where = (self.carry if key in self.carry else self.next).lines[key]
                lacks = "next" if key in self.carry else "carry"
                self.problems.add("repeat", where, f"{name}: {key!r} is missing in {lacks}:", fix="name it in both")

    def value(self, key: str, where: Where) -> Link | None:
        """The value after the last round."""
        return self.carried(self.count, key, where)

    def carried(self, rounds_done: int, key: str, where: Where) -> Link | None:
        """The value of `key` after `rounds_done` rounds."""
        if key not in self.carry or key not in self.next:
            if (key in self.carry) == (key in self.next):
                what = f"{self.name} carries no {key!r}"
                self.problems.add("repeat", where, what, nearest=closest(key, self.carry))
            return None
        link = None
        first = min(self.reached.get(key, 0), rounds_done)
        for done in range(first, rounds_done + 1):  # the first rounds first: a chain of 1000 would be a deep recursion
            self.reached[key] = max(self.reached.get(key, 0), done)
            if done == rounds_done or (done, key) not in self.known:
                scope, source = (self.outer, self.carry) if done == 0 else (self.scopes[done - 1], self.next)
                link = self.resolved((done, key), repr(key), source[key], source.lines[key], scope, where)
        return link


class Part(_Named):
    """One use of a sub-graph: the links it was given, in the scope of its user, and its own scope."""

    scope: Scope

    def __init__(
        self, name: str, tree: Tree, given: Mapping[str, tuple[Any, Where]], outer: Scope, links: Links, where: Where
    ) -> None:
        super().__init__(name, links)
        self.tree, self.given, self.outer, self.where = tree, given, outer, where

    def input(self, name: str, where: Where) -> Link | None:
        """What `@inputs.name` means: a link, ABSENT where it was not given, None after a problem."""
        if name not in self.tree.inputs:
            what = f"{self.tree.file.name} has no input {name!r}"
            self.problems.add("link", where, what, nearest=closest(name, self.tree.inputs))
            return None
        if name not in self.given:
            return ABSENT
        key = f"inputs.{name}"
        return self.resolved(key, key, *self.given[name], self.outer, where)

    def value(self, port: str, where: Where) -> Link | None:
        """What `@part.port` means outside."""
        outputs = self.tree.outputs
        if port not in outputs:
            names = [f"@{self.name}.{name}" for name in closest(port, outputs)]
            what = f"the sub-graph {self.name} ({self.tree.file.name}) has no output {port!r}"
            self.problems.add("unknown-port", where, what, nearest=names)
            return None
        return self.resolved(port, port, outputs[port], outputs.lines[port], self.scope, where)


class Passed(_Named):
    """A node or sub-graph that is bypassed: a link to an output means what the input in its place is linked to."""

    def __init__(self, name: str, through: Mapping[str, tuple[Any, Where]], outer: Scope, links: Links) -> None:
        super().__init__(name, links)
        self.through, self.outer = through, outer

    def value(self, port: str, where: Where) -> Link | None:
        """What stands for an output."""
        if port not in self.through:
            what, fix = f"{self.name} is bypassed without its output {port!r}", f"bypass: {{{port}: INPUT}}"
            self.problems.add("bypass", where, what, nearest=closest(port, self.through), fix=fix)
            return None
        return self.resolved(port, port, *self.through[port], self.outer, where)
