"""A merged graph file being changed: nodes by path, and every place where a link stands, before unrolling.

A path names a node through the blocks it lies in, without rounds: `rounds.merge`. A scope is the path of a block (the
empty one is the graph itself); links are read in the scope they stand in, inner names first, as `expand` reads them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, signature_of
from exmesh_graph.graph.language.params import declare
from exmesh_graph.graph.language.spec import resolve_params, substitute
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where, fail, nearest, without_rounds

_ADDRESS = re.compile(r"[A-Za-z_][\w-]*(\[\d+\])?(\.[A-Za-z_][\w-]*(\[\d+\])?)*")
_LINK = re.compile(r"@([^@\s]+)\.([A-Za-z_]\w*)")


def refuse(where: Where, what: str, *, near: Iterable[str] = (), **more: Any) -> NoReturn:
    """A patch whose precondition does not hold; `more` are Problem's expected, found and fix."""
    fail("patch", where, what, nearest=near, **more)


def is_block(entry: Any) -> bool:
    """Whether an entry is a repeat block with nodes."""
    return isinstance(entry, Map) and "repeat" in entry and isinstance(entry.get("nodes"), Map)


def is_part(entry: Any) -> bool:
    """Whether an entry uses a graph file as a sub-graph."""
    return isinstance(entry, Map) and "graph" in entry


def is_link(value: Any) -> bool:
    """Whether a value is a link (`@@` begins a plain string)."""
    return isinstance(value, str) and value.startswith("@") and not value.startswith("@@")


def layers_of(entry: Map) -> Iterator[tuple[Map, str, Any]]:
    """(settings, `every` or `at`, number) of single rounds of a node."""
    for key in ("every", "at"):
        rounds = entry.get(key)
        for number, layer in rounds.items() if isinstance(rounds, Map) else ():
            if isinstance(layer, Map):
                yield layer, key, number


def home_of(path: str) -> str:
    """The scope that a node stands in."""
    return path.rpartition(".")[0]


def within(path: str, scope: str) -> bool:
    """Whether `path` is `scope` or lies in it."""
    return not scope or path == scope or path.startswith(scope + ".")


@dataclass(frozen=True)
class Place:
    """A node or block by its path; none where a link comes from `@carry`."""

    path: str

    @property
    def scope(self) -> str:
        return self.path.rpartition(".")[0]

    @property
    def name(self) -> str:
        return self.path.rpartition(".")[2]


@dataclass(frozen=True)
class Address(Place):
    """What a patch names: a node or block, one round of its block if given, and a key in it."""

    round: int | None = None
    key: str = ""


@dataclass(frozen=True)
class Source(Place):
    """Where a link comes from: a node, or a block whose carried value is meant."""

    port: str
    text: str
    by_round: bool = False


@dataclass(frozen=True)
class LinkPlace:
    """A place where a link stands: `holder[key]`, read in `scope`. `owner` is the node or block it belongs to.

    In a list of links, `holder` is the list, which stands at `at`.
    """

    holder: Any
    key: Any
    scope: str
    owner: str
    label: str
    at: Where | None = None

    @property
    def text(self) -> str:
        return str(self.holder[self.key])

    def put(self, text: str, where: Where) -> None:
        """Write another link there."""
        self.holder[self.key] = text
        if self.at is None:
            self.holder.lines[self.key] = where

    @property
    def where(self) -> Where:
        return self.at or self.holder.lines[self.key]


@dataclass
class Draft:
    """A private copy of a merged file, changed in place by the operations of one patch list."""

    top: Map
    packs: Packs

    @property
    def entries(self) -> dict[str, Any]:
        """All nodes and blocks by their paths, in the order of the file."""
        found: dict[str, Any] = {}

        def walk(nodes: Map, prefix: str) -> None:
            for name, entry in nodes.items():
                found[f"{prefix}{name}"] = entry
                if is_block(entry):
                    walk(entry["nodes"], f"{prefix}{name}.")

        walk(self.inside(""), "")
        return found

    def inside(self, scope: str) -> Map:
        """The nodes of a scope."""
        nodes = self.top.get("nodes")
        nodes = nodes if isinstance(nodes, Map) else Map(self.top.where)
        for name in filter(None, scope.split(".")):
            nodes = nodes[name]["nodes"]
        return nodes

    # --- what a patch names

    def address(self, text: Any, where: Where, *, key: bool) -> Address:
        """Read `rounds.merge` (a node) or, with `key`, `rounds[3].merge.views` (a node and a key of it)."""
        shown = "node.port or node.parameter" if key else "a node's name, with its block: rounds.merge"
        if not isinstance(text, str) or not _ADDRESS.fullmatch(text):
            refuse(where, f"{text!r} names nothing", expected=shown)
        node, _, last = text.rpartition(".") if key else (text, "", "")
        if key and (not node or "[" in last):
            near = self._keys_like(without_rounds(last))
            refuse(where, f"{text!r} names no key of a node", expected=shown, near=near)
        path, entries = without_rounds(node), self.entries
        if path not in entries:
            what = f"there is no node {path!r}"
            if key and f"{path}.{last}" in entries:
                what = f"{text!r} is a node, not a key of one"
            fix = "name a node of a block with its block: rounds.merge"
            if self.part_around(path):
                fix = "put this patch into a file that extends the sub-graph's"
            refuse(where, what, near=nearest(path, entries) or list(entries)[:5], fix=fix)
        number = re.search(r"\[(\d+)\]\.[^.\[]*\Z", node)
        if node.count("[") > bool(number):
            refuse(where, f"{text!r}: a round can be named for the innermost block only", expected="rounds[3].merge")
        return Address(path, int(number[1]) if number else None, last)

    def part_around(self, text: str) -> str:
        """The path of the sub-graph that something lies in; none where it lies in no one."""
        plain, entries = without_rounds(text), self.entries.items()
        parts = (path for path, entry in entries if is_part(entry) and path != plain and within(plain, path))
        return next((path for path in parts if within(text, path)), "")  # not where a round of it is meant

    def _keys_like(self, key: str) -> list[str]:
        kinds = {path: kind for path, entry in self.entries.items() if (kind := self.kind(entry)) is not None}
        holders = [path for path, kind in kinds.items() if key in {**kind.inputs, **kind.params.model_fields}]
        return [f"{path}.{key}" for path in holders[:3]]

    # --- types

    def kind(self, entry: Any) -> Signature | None:
        """The signature of an entry's type; None where it has none or an unknown one (`check` will say so)."""
        return signature_of(self.packs, self.read(entry, "type")) if isinstance(entry, Map) else None

    def kinds(self, entry: Map) -> list[Signature]:
        """The signatures a node has over its rounds."""
        return [kind for one in (entry, *(row[0] for row in layers_of(entry))) if (kind := self.kind(one)) is not None]

    def read(self, entry: Map, key: str) -> Any:
        """A value of an entry with `${name}` replaced by the graph's parameters; None where there is none."""
        if key not in entry or not isinstance(entry[key], str) or "${" not in entry[key]:
            return entry.get(key)
        raw = self.top.get("params") or Map(self.top.where)
        scope = resolve_params(declare(raw, Problems()), Problems(), {}, {})
        return substitute(entry[key], scope, entry.lines[key], Problems()).value

    def known_type(self, name: Any, where: Where) -> Signature:
        """The signature of a type that a patch names."""
        kind = signature_of(self.packs, name)
        if kind is None:
            near = nearest(str(name), self.packs.types)
            refuse(where, f"there is no node type {name!r}", near=near, fix="exmesh nodes lists all types")
        return kind

    # --- links

    def link_places(self) -> Iterator[LinkPlace]:
        """Every place where a link stands, in the order of the file."""
        holders: list[tuple[Any, str, str, str]] = []
        for path, entry in self.entries.items():
            scope = home_of(path)
            if is_block(entry):
                holders += [(entry.get("carry"), scope, path, f"{path}.carry")]
                holders += [(entry.get("next"), path, path, f"{path}.next")]
            elif isinstance(entry, Map):
                holders += [(entry, scope, path, path)]
                holders += [(layer, scope, path, f"{path} ({word} {n})") for layer, word, n in layers_of(entry)]
        for holder, scope, owner, label in [*holders, (self.top.get("outputs"), "", "outputs", "outputs")]:
            for key, value in holder.items() if isinstance(holder, Map) else ():
                if is_link(value) and key != "doc":
                    yield LinkPlace(holder, key, scope, owner, f"{label}.{key}")
                for index in [i for i, item in enumerate(value) if is_link(item)] if isinstance(value, list) else ():
                    yield LinkPlace(value, index, scope, owner, f"{label}.{key}", holder.lines[key])

    def source(self, text: str, scope: str) -> Source | None:
        """What a link means in `scope`; None where it means nothing."""
        match = _LINK.fullmatch(text.replace("[*]", "[1]"))
        node, port = match.groups() if match else (text.removeprefix("@"), "")
        if node == "carry":
            return Source("", port, text)
        while "." not in node:
            if node in self.inside(scope):
                return Source(f"{scope}.{node}".lstrip("."), port, text)
            if not scope:
                return None
            scope = home_of(scope)
        known = _ADDRESS.fullmatch(node) and without_rounds(node) in self.entries
        return Source(without_rounds(node), port, text, by_round=True) if known else None

    def users(self, *paths: str) -> list[tuple[LinkPlace, Source]]:
        """The places that link to nodes or blocks, those inside them left out."""

        def among(path: str) -> bool:
            return any(within(path, other) for other in paths)

        ends = [(place, self.source(place.text, place.scope)) for place in self.link_places() if not among(place.owner)]
        return [(place, source) for place, source in ends if source is not None and among(source.path)]

    def port_of(self, text: str, scope: str) -> Port | None:
        """The output port behind a link, through carried values; None where it cannot be told."""
        seen: set[tuple[str, str]] = set()
        while True:
            source = self.source(text, scope)
            path = "" if source is None else source.path or scope
            entry = self.entries.get(path)
            if source is None or not isinstance(entry, Map):
                return None
            if not is_block(entry):
                kind = self.kind(entry)
                return kind.outputs.get(source.port) if kind else None
            carry = entry.get("carry")
            if (path, source.port) in seen or not isinstance(carry, Map) or source.port not in carry:
                return None
            seen.add((path, source.port))
            text, scope = str(carry[source.port]), home_of(path)

    def moved(self, text: str, home: str, place: LinkPlace, source: Source, where: Where) -> str:
        """`text`, written in the scope `home`, as it must read at `place`, which links to `source` in that scope."""
        meant = self.source(text, home)
        if meant is None or (meant.path and self.source(text, place.scope) == meant):
            return text
        if place.scope == home and not source.by_round:
            return text
        if not source.by_round or meant.scope != home or not meant.path:
            what = f"{place.label} ({place.where}) links here as {source.text!r}, where {text!r} means something else"
            refuse(where, what, fix=f"connect {place.label} first")
        block, _, _ = source.text.rsplit(".", 2)
        return f"{block}.{meant.name}.{meant.port}"

    def check_free(self, name: Any, scope: str, where: Where) -> str:
        """Refuse a new node's name that is taken, or that would hide another node from links."""
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_][\w-]*", name) or name == "carry":
            refuse(where, f"{name!r} is not a name for a node", expected="letters, digits, _ and -")
        for path in self.entries:
            home, _, other = path.rpartition(".")
            if other == name and (within(scope, home) or within(home, scope)):
                what = f"there is a node {path!r} already" if home == scope else f"{name!r} would hide {path!r}"
                refuse(where, what, fix=f"choose another name, or change the node: {{replace: {path}, type: ...}}")
        return name
