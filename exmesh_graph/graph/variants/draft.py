"""A merged graph file being changed: nodes by path, and every place where a link stands, before unrolling.

A path names a node through the blocks it lies in, without rounds: `rounds.merge`. A scope is the path of a block (the
empty one is the graph itself); links are read in the scope they stand in, inner names first, as `expand` reads them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, signature
from exmesh_graph.graph.language.params import declare
from exmesh_graph.graph.language.spec import Value, resolve_params, substitute
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where, nearest
from exmesh_graph.graph.variants.entries import is_block, is_link, is_part, layers_of, refuse

Names = tuple[str, ...]
_PART = re.compile(r"([A-Za-z_][\w-]*)(?:\[(\d+)\])?\Z")
_LINK = re.compile(r"@([^@\s]+)\.([A-Za-z_]\w*)\Z")


@dataclass(frozen=True)
class Address:
    """What a patch names: a node or block by its path, one round of its block if given, and a key in it."""

    path: Names
    round: int | None = None
    key: str = ""

    @property
    def scope(self) -> Names:
        return self.path[:-1]

    def __str__(self) -> str:
        parts = list(self.path)
        if self.round is not None:
            parts[-2] += f"[{self.round}]"
        return ".".join([*parts, self.key] if self.key else parts)


@dataclass(frozen=True)
class Source:
    """Where a link comes from. `path` is a node, or a block whose carried value is meant; None for `@carry`."""

    path: Names | None
    port: str
    text: str
    by_round: bool = False


@dataclass(frozen=True)
class LinkPlace:
    """A place where a link stands: `holder[key]`, read in `scope`. `owner` is the node or block it belongs to."""

    holder: Map
    key: Any
    scope: Names
    owner: Names
    label: str

    @property
    def text(self) -> str:
        return str(self.holder[self.key])

    @property
    def where(self) -> Where:
        return self.holder.lines[self.key]

    def put(self, text: str, where: Where) -> None:
        self.holder.put(self.key, text, where)


@dataclass
class Draft:
    """A private copy of a merged file, changed in place by the operations of one patch list."""

    top: Map
    packs: Packs

    @property
    def nodes(self) -> Map:
        nodes = self.top.get("nodes")
        return nodes if isinstance(nodes, Map) else Map(self.top.where)

    def inside(self, scope: Names) -> Map:
        """The nodes of a scope."""
        nodes = self.nodes
        for name in scope:
            nodes = nodes[name]["nodes"]
        return nodes

    def entry(self, path: Names) -> Map:
        """The entry of a node or block that exists."""
        entry: Map = self.inside(path[:-1])[path[-1]]
        return entry

    def paths(self) -> Iterator[Names]:
        """All nodes and blocks."""

        def walk(nodes: Map, scope: Names) -> Iterator[Names]:
            for name, entry in nodes.items():
                yield (*scope, str(name))
                if is_block(entry):
                    yield from walk(entry["nodes"], (*scope, str(name)))

        return walk(self.nodes, ())

    def names(self) -> list[str]:
        return [".".join(path) for path in self.paths()]

    # --- what a patch names

    def address(self, text: Any, where: Where, *, key: bool) -> Address:
        """Read `rounds.merge` (a node) or, with `key`, `rounds[3].merge.views` (a node and a key of it)."""
        parts = [_PART.match(part) for part in text.split(".")] if isinstance(text, str) else []
        shown = "node.port or node.parameter" if key else "a node's name, with its block: rounds.merge"
        if not parts or not all(parts):
            refuse(where, f"{text!r} names nothing", expected=shown)
        read = [(match.group(1), match.group(2)) for match in parts if match]
        last = read.pop() if key else None
        if last and (not read or last[1]):
            refuse(where, f"{text!r} names no key of a node", expected=shown, near=self._keys_like(last[0]))
        path = tuple(name for name, _ in read)
        if path not in set(self.paths()):
            plain = ".".join(path)
            what = f"there is no node {plain!r}"
            if key and (*path, last[0] if last else "") in set(self.paths()):
                what = f"{text!r} is a node, not a key of one"
            near = nearest(plain, self.names()) or self.names()[:5]
            fix = "name a node of a block with its block: rounds.merge"
            if any(is_part(self.entry(p)) for p in self.paths() if p == path[: len(p)]):
                fix = "only set and connect reach into sub-graphs; put other patches into a file that extends it"
            refuse(where, what, near=near, fix=fix)
        rounds = [(index, number) for index, (_, number) in enumerate(read) if number is not None]
        if any(index != len(path) - 2 for index, _ in rounds):
            refuse(where, f"{text!r}: a round can be named for the innermost block only", expected="rounds[3].merge")
        return Address(path, int(rounds[0][1]) if rounds else None, last[0] if last else "")

    def _keys_like(self, key: str) -> list[str]:
        holders = [name for name in self.names() if not is_block(entry := self.entry(tuple(name.split("."))))
                 and isinstance(entry, Map) and (kind := self.kind(entry)) is not None
                 and (key in kind.inputs or key in kind.params.model_fields)]  # fmt: skip
        return [f"{name}.{key}" for name in holders[:3]]

    # --- types

    def kind(self, entry: Map) -> Signature | None:
        """The signature of an entry's type; None where the type is unknown (`check` will say so)."""
        return self.type_named(self.read(entry, "type"))

    def kinds(self, entry: Map) -> list[Signature]:
        """The signatures a node has over its rounds."""
        kinds = [self.kind(holder) for holder in (entry, *(layer for layer, _, _ in layers_of(entry)))]
        return [kind for kind in kinds if kind is not None]

    def read(self, entry: Map, key: str) -> Any:
        """A value of an entry with `${name}` replaced by the graph's parameters; None where there is none."""
        if key not in entry or not isinstance(entry[key], str):
            return entry.get(key)
        raw = self.top.get("params") or Map(self.top.where)
        declared = declare(raw, Problems())
        given = {name: Value(param.default, param.where, param.where.base) for name, param in declared.items()}
        return substitute(entry[key], resolve_params(given, Problems()), entry.lines[key], Problems()).value

    def type_named(self, name: Any) -> Signature | None:
        definition = self.packs.find(name) if isinstance(name, str) else None
        try:
            return None if definition is None else signature(definition)
        except (TypeError, NameError):
            return None

    def known_type(self, name: Any, where: Where) -> Signature:
        """The signature of a type that a patch names."""
        kind = self.type_named(name)
        if kind is None:
            near = nearest(str(name), self.packs.types)
            refuse(where, f"there is no node type {name!r}", near=near, fix="exmesh nodes lists all types")
        return kind

    # --- links

    def link_places(self) -> Iterator[LinkPlace]:
        """Every place where a link stands, in the order of the file."""
        yield from self._places_in(self.nodes, ())
        outputs = self.top.get("outputs")
        if isinstance(outputs, Map):
            yield from _links_of(outputs, (), ("outputs",), "outputs")

    def _places_in(self, nodes: Map, scope: Names) -> Iterator[LinkPlace]:
        for name, entry in nodes.items():
            path = (*scope, str(name))
            label = ".".join(path)
            if not isinstance(entry, Map):
                continue
            if is_block(entry):
                for key, inner in (("carry", scope), ("next", path)):
                    if isinstance(entry.get(key), Map):
                        yield from _links_of(entry[key], inner, path, f"{label}.{key}")
                yield from self._places_in(entry["nodes"], path)
                continue
            yield from _links_of(entry, scope, path, label)
            for layer, word, number in layers_of(entry):
                yield from _links_of(layer, scope, path, f"{label} ({word} {number})")

    def source(self, text: str, scope: Names) -> Source | None:
        """What a link means in `scope`; None where it means nothing."""
        match = _LINK.match(text)
        node, port = match.groups() if match else (text.removeprefix("@"), "")
        if node == "carry":
            return Source(None, port, text)
        for depth in range(len(scope), -1, -1):
            if node in self.inside(scope[:depth]):
                return Source((*scope[:depth], node), port, text)
        parts = [_PART.match(part) for part in node.split(".")]
        path = tuple(part.group(1) for part in parts if part)
        if len(path) == len(parts) > 1 and path in set(self.paths()):
            return Source(path, port, text, by_round=True)
        return None

    def users(self, path: Names, port: str | None = None) -> list[tuple[LinkPlace, Source]]:
        """The places that link to a node or block (to one of its ports), those inside it left out."""
        users = []
        for place in self.link_places():
            if place.owner[: len(path)] == path:
                continue
            source = self.source(place.text, place.scope)
            if source is None or source.path is None or source.path[: len(path)] != path:
                continue
            if port is None or (source.port == port and source.path == path):
                users.append((place, source))
        return users

    def port_of(self, text: str, scope: Names) -> Port | None:
        """The output port behind a link, through carried values; None where it cannot be told."""
        seen: set[tuple[Names, str]] = set()
        while True:
            source = self.source(text, scope)
            if source is None:
                return None
            path = scope if source.path is None else source.path
            entry = self.entry(path) if path else None
            if not isinstance(entry, Map):
                return None
            if not is_block(entry):
                kind = self.kind(entry)
                return kind.outputs.get(source.port) if kind else None
            carry = entry.get("carry")
            if (path, source.port) in seen or not isinstance(carry, Map) or source.port not in carry:
                return None
            seen.add((path, source.port))
            text, scope = str(carry[source.port]), path[:-1]

    def moved(self, text: str, home: Names, place: LinkPlace, source: Source, where: Where) -> str:
        """`text`, written in the scope `home`, as it must read at `place`, which links to `source` in that scope."""
        meant = self.source(text, home)
        if meant is None or (meant.path is not None and self.source(text, place.scope) == meant):
            return text
        if place.scope == home and not source.by_round:
            return text
        if not source.by_round or meant.path is None or meant.path[:-1] != home:
            what = f"{place.label} ({place.where}) links here as {source.text!r}, where {text!r} means something else"
            refuse(where, what, fix=f"connect {place.label} first")
        node = source.text.removeprefix("@").rpartition(".")[0].rpartition(".")[0]
        return f"@{node}.{meant.path[-1]}.{meant.port}"

    def check_free(self, name: Any, scope: Names, where: Where) -> str:
        """Refuse a new node's name that is taken, or that would hide another node from links."""
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_][\w-]*", name) or name == "carry":
            refuse(where, f"{name!r} is not a name for a node", expected="letters, digits, _ and -")
        for path in self.paths():
            if path[-1] == name and (path[:-1] == scope[: len(path) - 1] or path[: len(scope)] == scope):
                taken = ".".join(path)
                what = f"there is a node {taken!r} already" if path[:-1] == scope else f"{name!r} would hide {taken!r}"
                refuse(where, what, fix=f"choose another name, or change the node: {{replace: {taken}, type: ...}}")
        return name


def _links_of(holder: Map, scope: Names, owner: Names, label: str) -> Iterator[LinkPlace]:
    for key, value in holder.items():
        if is_link(value) and key != "doc":
            yield LinkPlace(holder, key, scope, owner, f"{label}.{key}")
