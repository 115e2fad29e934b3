"""The nodes of a graph that is built in Python, and those of its repeat blocks: adding, changing and wiring them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Self

from exmesh_graph.api.arguments import by_name, path_of
from exmesh_graph.api.families import Families
from exmesh_graph.api.judge import declared, judge, plug_of
from exmesh_graph.api.values import Node, Parameter, Plug, UnknownPort, Wire, here, plain
from exmesh_graph.graph.declare.ports import Port
from exmesh_graph.graph.language.spec import NAME
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, Problem, Problems, Where, fail, nearest

if TYPE_CHECKING:
    from exmesh_graph.api.builder import Graph


class NodeScope:
    """Nodes that see each other: those of a graph, or of one of its repeat blocks."""

    graph: Graph
    name: str
    outer: NodeScope | None = None

    @property
    def own(self) -> Map:
        """The entries written here."""
        raise NotImplementedError

    def written(self) -> Map:
        """The same, to be changed."""
        return self.own

    @property
    def base(self) -> Map:
        """The entries of what the graph extends."""
        raise NotImplementedError

    @property
    def nodes(self) -> Families:
        """Nodes by family, for editors: `g.nodes.init.visual_hull(views=views.train)`, which also takes `name`."""
        return Families(self)

    def add(self, name: str, type: str | Callable[..., Any], /, *given: Any, **fields: Any) -> Node:
        """Add a node or a component; `fields` are its inputs, parameters, seed, doc, at and every. Raises GraphErrors.

        The type may be the function or class itself that `node` or `component` declares.
        """
        where, problems = here(), Problems()
        _refuse_name(name, self, where)
        entry = Map(where)
        entry.put("type", type if isinstance(type, str) else declared(type, self.graph.packs, where).type, where)
        self._by_name(given, str(entry["type"]))
        own = self.written()
        before = own.copy()
        own.put(name, entry, where)
        try:
            self._fill(name, entry, fields, where, problems)
        except GraphErrors:
            _restore(own, before)  # with the components that it brought
            raise
        return Node(self, name)

    def set(self, node: str | Node, /, *given: Any, **fields: Any) -> None:
        """Change inputs and parameters of a node, also of one from the graph that this one extends or uses."""
        where = here()
        scope, name = self.at(str(node).removeprefix("@"), where)
        scope._by_name(given, scope.type_of(name))
        scope._fill(name, scope.patch(name, where), fields, where, Problems())

    def remove(self, node: str | Node) -> None:
        """Take a node out, also one from the graph that this one extends."""
        where = here()
        scope, name = self.at(str(node).removeprefix("@"), where)
        scope.written().pop(name, None)
        if name in scope.base:
            scope.written().put(name, None, where)

    def repeat(self, name: str, count: int | Parameter, /, **carry: Any) -> RepeatBlock:
        """A block of nodes that is unrolled `count` times; `carry` is what goes into the first round."""
        where, problems = here(), Problems()
        _refuse_name(name, self, where)
        entry, carried = Map(where), Map(where)
        for key, value in carry.items():
            carried.put(key, self._value(f"{name}.{key}", value, None, where, problems), where)
        problems.raise_if_any()
        entry.put("repeat", plain(count, f"{name}.repeat", where, problems), where)
        entry.put("carry", carried, where)
        entry.put("nodes", Map(where), where)
        entry.put("next", Map(where), where)
        self.written().put(name, entry, where)
        return RepeatBlock(self, name)

    def part(self, name: str, file: str | os.PathLike[str], /, **fields: Any) -> Node:
        """Use another graph file like a node; `fields` are its inputs and parameters, `nodes` changes to its nodes."""
        where, problems = here(), Problems()
        _refuse_name(name, self, where)
        if isinstance(file, NodeScope):
            what, fix = f"{name}: a graph that is used in another one lies in a file", "save it by to_yaml(file) first"
            fail("graph", where, what, expected="the path of a graph file", fix=fix)
        entry = Map(where)
        entry.put("graph", os.fspath(path_of(file, name, "the path of a graph file")), where)
        for key, value in fields.items():
            entry.put(key, self._value(f"{name}.{key}", value, None, where, problems), where)
        problems.raise_if_any()
        self.written().put(name, entry, where)
        return Node(self, name)

    def __getitem__(self, name: str) -> Node | RepeatBlock:
        """A node or block by its name; `rounds.refine` is a node in a block."""
        scope, last = self.at(str(name).removeprefix("@"), here())
        return RepeatBlock(scope, last) if scope._has(last, "repeat") else Node(scope, last)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __contains__(self, name: object) -> bool:
        return name in list(self)

    def __iter__(self) -> Iterator[str]:
        """The names of its nodes and blocks."""
        for name in dict.fromkeys([*self.base, *self.own]):
            if not (name in self.own and self.own[name] is None):
                yield str(name)

    def entry(self, name: str) -> tuple[Map, Map]:
        """What is written of a node here, and in what the graph extends."""
        own, base = self.own.get(name), self.base.get(name)
        return map_or_empty(own, self.own.where), map_or_empty(base, self.own.where)

    def where_of(self, name: str) -> Where:
        """Where a node was written."""
        return self.own.lines.get(name) or self.base.lines.get(name) or self.own.where

    def type_of(self, name: str) -> str:
        """The type of a node as written; empty for blocks and sub-graphs."""
        own, base = self.entry(name)
        return str(own.get("type", base.get("type", "")))

    def outputs_of(self, name: str) -> list[str] | None:
        """The names of a node's outputs; None where they are not known."""
        known = self.graph.signature(self.type_of(name))
        if known is not None:
            return list(known.outputs)
        own, base = self.entry(name)
        if "repeat" in own or "repeat" in base:
            return [str(key) for layer in (base, own) for key in layer.get("carry") or ()]
        return None

    def source(self, text: str) -> tuple[str, NodeScope, str] | None:
        """(node, its scope, port) that a link written here leads to, through blocks; None where that is not known."""
        node, _, port = text.removeprefix("@").rpartition(".") if "." in text else (text.removeprefix("@"), "", "")
        scope: NodeScope | None = self
        if node == "carry" and isinstance(self, RepeatBlock):
            link = self.carried("carry", port)
            return self.scope.source(link) if link else None
        while scope is not None and node not in scope:
            scope = scope.outer
        if scope is None:
            return None
        if scope.type_of(node):
            return node, scope, port
        if scope._has(node, "repeat"):
            block = RepeatBlock(scope, node)
            link = block.carried("next", port)
            return block.source(link) if link else None
        return None

    def at(self, path: str, where: Where) -> tuple[NodeScope, str]:
        """The scope and the name of a node given as `refine` or `rounds.refine`."""
        scope, (*blocks, last) = self, path.split(".")
        for block in blocks:
            if not scope._has(block, "repeat"):
                if scope._has(block, "graph"):
                    scope = _Inside(scope, block)
                    continue
                fail(
                    "unknown-node", where, f"there is no block {block!r}", nearest=nearest(block, scope) or list(scope)
                )
            scope = RepeatBlock(scope, block)
        if last not in scope and not isinstance(scope, _Inside):
            what = f"{self.graph.name} has no node {path!r}"
            fail("unknown-node", where, what, nearest=nearest(last, scope) or list(scope)[:8])
        return scope, last

    def _has(self, name: str, key: str) -> bool:
        return any(key in layer for layer in self.entry(name))

    def patch(self, name: str, where: Where) -> Map:
        """The own entry of a node, made where only what the graph extends has one."""
        own = self.written()
        if not isinstance(own.get(name), Map):
            own.put(name, Map(where), where)
        return own[name]  # type: ignore[no-any-return]

    def _fill(self, name: str, entry: Map, fields: Mapping[str, Any], where: Where, problems: Problems) -> None:
        """Put values into an entry and judge the node. Raises GraphErrors, and leaves the entry as it was."""
        before, known = entry.copy(), self.graph.signature(self.type_of(name))
        try:
            for key, value in fields.items():
                port = known.inputs.get(known.renamed.get(key, key)) if known else None
                entry.put(key, self._value(f"{name}.{key}", value, port, where, problems), where)
            if not problems:
                self._judge(name, problems)
            problems.raise_if_any()
        except GraphErrors:
            _restore(entry, before)
            raise

    def _value(self, what: str, value: Any, port: Port | None, where: Where, problems: Problems) -> Any:
        """A field's value as a graph file holds it. A plug becomes a component of its own, called `node_field`."""
        plug = plug_of(value, self.graph.packs, where)
        if isinstance(value, str) and port is not None and self._names_component(value, port):
            plug = Plug(value, {})
        if plug is not None:
            name = what.replace(".", "_")
            while name in self:
                name += "_"
            return str(self.add(name, plug.type, **plug.fields))
        if isinstance(value, RepeatBlock):
            value = Node(value.scope, value.name)
        if isinstance(value, Node):
            if self.graph.is_component(value._scope.type_of(value._name)):
                self._visible(what, value._scope, value._name, where, problems)
                return str(value)
            outputs = value._scope.outputs_of(value._name) or []
            known = value._scope.graph.signature(value._scope.type_of(value._name))
            fits = [key for key in outputs if port is None or known is None or port.takes(known.outputs[key])]
            if len(fits) != 1:
                problems.add("link", where, f"{what} takes one output, and {value._name} is a node",
                             expected="" if port is None else str(port),
                             nearest=[f"{value._name}.{key}" for key in fits or outputs])  # fmt: skip
                return None
            value = value[fits[0]]
        if isinstance(value, Wire):
            self._visible(what, value.scope, value.node, where, problems)
        return plain(value, what, where, problems)

    def _names_component(self, text: str, port: Port) -> bool:
        """Whether a text is the type of a component, for a port that takes any."""
        return (port.plugged or port.mixed) and not text.startswith("@") and self.graph.is_component(text)

    def _visible(self, what: str, source: NodeScope, node: str, where: Where, problems: Problems) -> None:
        """Note a wire from another graph, or out of a block that it does not reach out of."""
        scope: NodeScope | None = self
        if node not in ("inputs", "carry"):  # what is carried is seen in its own block alone
            while scope is not None and node not in scope:
                scope = scope.outer
        if source.graph is self.graph and (node == "inputs" or scope == source):
            return
        fix = ""
        if source.graph is not self.graph:
            state = f"{node} belongs to another graph, {source.graph.name}"
        elif isinstance(source, _Inside):
            state = f"{node} is inside the sub-graph {source.name}"
            fix = "wire an output of the sub-graph"
        elif node == "carry":
            state, fix = f"it is carried by {source.name}", f"carry it into {self.name} as well"
        elif isinstance(source, RepeatBlock):
            state = f"{node} is inside the repeat block {source.name}"
            fix = f"let {source.name}.next(...) hand it on, and wire what comes out of {source.name}"
        else:
            state = f"{node} is hidden by another node of that name"
        problems.add("link", where, f"{what} cannot be wired to {node}", found=state, fix=fix)

    def _by_name(self, given: tuple[Any, ...], kind: str) -> None:
        """Refuse what was given to a node by position."""
        known = self.graph.signature(kind) if given else None
        by_name(given, kind, [*known.inputs, *known.params.model_fields] if known else ())

    def _judge(self, name: str, problems: Problems) -> None:
        """Note what is known to be wrong with a node, by the checks of graph files."""
        told = judge(self, name)
        problems.noted.update(told.noted)


class RepeatBlock(NodeScope):
    """A repeat block of a graph; what its last round hands on are its attributes: `rounds.state`. Made by `repeat`."""

    def __init__(self, scope: NodeScope, name: str) -> None:
        self.scope, self.name, self.graph, self.outer = scope, name, scope.graph, scope

    @property
    def own(self) -> Map:
        return map_or_empty(self.scope.entry(self.name)[0].get("nodes"), self.scope.where_of(self.name))

    def written(self) -> Map:
        return child(self.scope.patch(self.name, here()), "nodes")

    @property
    def base(self) -> Map:
        return map_or_empty(self.scope.entry(self.name)[1].get("nodes"), self.scope.where_of(self.name))

    @property
    def carry(self) -> Node:
        """What is carried into a round: `rounds.carry.state`."""
        return _Carry(self)

    @property
    def round(self) -> Parameter:
        """The number of the round, from 1."""
        return Parameter("round")

    def next(self, **values: Any) -> None:
        """What a round hands on to the next one, and the last one to the outside; one for each name that is carried."""
        where, problems = here(), Problems()
        entry = child(self.scope.patch(self.name, where), "next")
        for key, value in values.items():
            if key not in self.carried_names():
                problems.add("repeat", where, f"{self.name} carries no {key!r}", nearest=self.carried_names())
            entry.put(key, self._value(f"{self.name}.next.{key}", value, None, where, problems), where)
        problems.raise_if_any()

    def carried_names(self) -> list[str]:
        return [str(key) for layer in reversed(self.scope.entry(self.name)) for key in layer.get("carry") or ()]

    def carried(self, part: str, key: str) -> str:
        """The link that `carry` or `next` gives for a name; empty where there is none yet."""
        for layer in self.scope.entry(self.name):
            if key in (layer.get(part) or ()):
                return str(layer[part][key])
        return ""

    def __getattr__(self, port: str) -> Wire[Any]:
        if port.startswith("_") or port in ("scope", "name", "graph", "outer"):
            raise AttributeError(port)
        return Node(self.scope, self.name)[port]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        return None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RepeatBlock) and (self.scope, self.name) == (other.scope, other.name)

    def __hash__(self) -> int:
        return hash((self.scope, self.name))

    def __repr__(self) -> str:
        return f"<repeat block {self.name}: {', '.join(self)}>"


class _Inside(RepeatBlock):
    """The changes to the nodes of a sub-graph."""

    def _judge(self, name: str, problems: Problems) -> None:
        """Nothing is known of the file yet."""


class _Carry(Node):
    """What goes into a round."""

    def __init__(self, block: RepeatBlock) -> None:
        super().__init__(block, "carry")

    def __getitem__(self, port: str) -> Wire[Any]:
        block = self._scope
        assert isinstance(block, RepeatBlock)
        if port not in block.carried_names():
            what = f"{block.name} carries no {port!r}"
            raise UnknownPort([Problem("repeat", here(), what, nearest=tuple(block.carried_names()))])
        return Wire(block, "carry", port)


def _restore(entry: Map, before: Map) -> None:
    entry.clear()
    entry.update(before)
    entry.lines = before.lines


def map_or_empty(value: Any, where: Where) -> Map:
    """A value that is a mapping, or an empty one in the place of any other."""
    return value if isinstance(value, Map) else Map(where)


def child(entry: Map, key: str) -> Map:
    """A mapping below a key, made where there is none."""
    if not isinstance(entry.get(key), Map):
        entry.put(key, Map(entry.where), entry.where)
    return entry[key]  # type: ignore[no-any-return]


def _refuse_name(name: str, scope: NodeScope, where: Where) -> None:
    problems = Problems()
    if not isinstance(name, str) or not NAME.match(name):
        problems.add("name", where, f"{name!r} is not a name", expected="letters, digits, _ and -")
    elif name in ("carry", "inputs"):
        problems.add("name", where, f"a node cannot be called {name!r}")
    elif isinstance(scope.own.get(name), Map):
        problems.add("duplicate-key", where, f"there is a node {name!r} already, from {scope.own.lines[name]}",
                     fix=f'change it: set("{name}", ...), or remove it first')  # fmt: skip
    problems.raise_if_any()
