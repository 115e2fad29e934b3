"""The nodes of a graph that is built in Python, and those of its repeat blocks: adding, changing and wiring them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

from exmesh_graph.api.arguments import by_name, path_of
from exmesh_graph.api.families import Families
from exmesh_graph.api.judge import declared, judge, plug_of
from exmesh_graph.api.values import Node, Parameter, Plug, UnknownPort, Wire, here, plain
from exmesh_graph.graph.declare.ports import Port
from exmesh_graph.graph.language.extends import merge_nodes
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
        where = here()
        _refuse_name(name, self, where)
        entry = Map(where)
        entry.put("type", type if isinstance(type, str) else declared(type, self.graph.packs, where).type, where)
        self._by_name(given, str(entry["type"]))
        own = self.written()
        with _or_as_before(own):  # without the components that it brought
            own.put(name, entry, where)
            self._fill(name, entry, fields, where)
        return Node(self, name)

    def set(self, node: str | Node, /, *given: Any, **fields: Any) -> None:
        """Change inputs and parameters of a node, also of one from the graph that this one extends or uses."""
        where, (scope, name) = here(), self.at(node)
        scope._by_name(given, scope.type_of(name))
        scope._fill(name, scope.written().inner(name, where), fields, where)

    def remove(self, node: str | Node) -> None:
        """Take a node out, also one from the graph that this one extends."""
        scope, name = self.at(node)
        scope.written().pop(name, None)
        if name in scope.base:
            scope.written().put(name, None, here())

    def repeat(self, name: str, count: int | Parameter, /, **carry: Any) -> RepeatBlock:
        """A block of nodes that is unrolled `count` times; `carry` is what goes into the first round."""
        where, problems = here(), Problems()
        _refuse_name(name, self, where)
        carried = {key: self._value(f"{name}.{key}", value, None, where, problems) for key, value in carry.items()}
        problems.raise_if_any()
        entry = plain({"repeat": count, "carry": carried, "nodes": {}, "next": {}}, name, where, problems)
        problems.raise_if_any()
        self.written().put(name, entry, where)
        return RepeatBlock(self, name)

    def part(self, name: str, file: str | os.PathLike[str], /, **fields: Any) -> Node:
        """Use another graph file like a node; `fields` are its inputs and parameters, `nodes` changes to its nodes."""
        where, problems = here(), Problems()
        _refuse_name(name, self, where)
        if isinstance(file, NodeScope):
            what, fix = f"{name}: a graph that is used in another one lies in a file", "save it by to_yaml(file) first"
            fail("graph", where, what, expected="the path of a graph file", fix=fix)
        values = {key: self._value(f"{name}.{key}", value, None, where, problems) for key, value in fields.items()}
        problems.raise_if_any()
        entry = plain({"graph": path_of(file, name, "the path of a graph file"), **values}, name, where, problems)
        self.written().put(name, entry, where)
        return Node(self, name)

    def __getitem__(self, name: str) -> Node | RepeatBlock:
        """A node or block by its name; `rounds.refine` is a node in a block."""
        scope, last = self.at(name)
        return RepeatBlock(scope, last) if "repeat" in scope.entry(last) else Node(scope, last)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __contains__(self, name: object) -> bool:
        return name in list(self)

    def __iter__(self) -> Iterator[str]:
        """The names of its nodes and blocks."""
        for name in dict.fromkeys([*self.base, *self.own]):
            if not (name in self.own and self.own[name] is None):
                yield str(name)

    def entry(self, name: str) -> Map:
        """What is written of a node here, over what the graph extends says of it."""
        own, base = (map_or_empty(layer.get(name), self.own.where) for layer in (self.own, self.base))
        return merge_nodes(_one(name, base), _one(name, own), Problems())[name] if own and base else own or base

    def where_of(self, name: str) -> Where:
        """Where a node was written."""
        return self.own.lines.get(name) or self.base.lines.get(name) or self.own.where

    def type_of(self, name: str) -> str:
        """The type of a node as written; empty for blocks and sub-graphs."""
        return str(self.entry(name).get("type", ""))

    def outputs_of(self, name: str) -> list[str] | None:
        """The names of a node's outputs; None where they are not known."""
        entry = self.entry(name)
        known = self.graph.signature(str(entry.get("type", "")))
        if known is not None:
            return list(known.outputs)
        return [str(key) for key in entry.get("carry") or ()] if "repeat" in entry else None

    def source(self, text: str) -> tuple[str, NodeScope, str] | None:
        """(node, its scope, port) that a link written here leads to, through blocks; None where that is not known."""
        node, _, port = text.removeprefix("@").partition(".")
        if node == "carry" and isinstance(self, RepeatBlock):
            link = self.carried("carry", port)
            return self.scope.source(link) if link else None
        scope = self.seen(node)
        if scope is None:
            return None
        if scope.type_of(node):
            return node, scope, port
        if "repeat" in scope.entry(node):
            block = RepeatBlock(scope, node)
            link = block.carried("next", port)
            return block.source(link) if link else None
        return None

    def seen(self, node: str) -> NodeScope | None:
        """The scope of a node that is seen from here: its own, or one around it."""
        scope: NodeScope | None = self
        while scope is not None and node not in scope:
            scope = scope.outer
        return scope

    def at(self, node: str | Node) -> tuple[NodeScope, str]:
        """The scope and the name of a node given as `refine` or `rounds.refine`, or by itself."""
        path, where = str(node).removeprefix("@"), here()
        scope, (*blocks, last) = self, path.split(".")
        for block in blocks:
            entry = scope.entry(block)
            if "repeat" not in entry and "graph" not in entry:
                what, near = f"there is no block {block!r}", nearest(block, scope) or list(scope)
                fail("unknown-node", where, what, nearest=near)
            scope = RepeatBlock(scope, block) if "repeat" in entry else _Inside(scope, block)
        if last not in scope and not isinstance(scope, _Inside):
            what = f"{self.graph.name} has no node {path!r}"
            fail("unknown-node", where, what, nearest=nearest(last, scope) or list(scope)[:8])
        return scope, last

    def _fill(self, name: str, entry: Map, fields: Mapping[str, Any], where: Where) -> None:
        """Put values into an entry and judge the node. Raises GraphErrors, and leaves the entry as it was."""
        problems, known = Problems(), self.graph.signature(self.type_of(name))
        with _or_as_before(entry):
            for key, value in fields.items():
                port = known.inputs.get(known.renamed.get(key, key)) if known else None
                entry.put(key, self._value(f"{name}.{key}", value, port, where, problems), where)
            (problems or judge(self, name)).raise_if_any()

    def _value(self, what: str, value: Any, port: Port | None, where: Where, problems: Problems) -> Any:
        """A field's value as a graph file holds it. A plug becomes a component of its own, called `node_field`."""
        if port is not None and port.many and isinstance(value, list | tuple):
            one = replace(port, many=False)
            return [self._value(f"{what}[{n}]", item, one, where, problems) for n, item in enumerate(value, 1)]
        plug = plug_of(value, self.graph.packs, where)
        if isinstance(value, str) and port is not None and (port.plugged or port.mixed):
            plug = Plug(value, {}) if self.graph.is_component(value) else None
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

    def _visible(self, what: str, source: NodeScope, node: str, where: Where, problems: Problems) -> None:
        """Note a wire from another graph, or out of a block that it does not reach out of."""
        scope = self if node in ("inputs", "carry") else self.seen(node)  # what is carried: in its own block alone
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


class RepeatBlock(NodeScope):
    """A repeat block of a graph; what its last round hands on are its attributes: `rounds.state`. Made by `repeat`."""

    def __init__(self, scope: NodeScope, name: str) -> None:
        self.scope, self.name, self.graph, self.outer = scope, name, scope.graph, scope

    @property
    def own(self) -> Map:
        return self._nodes_in(self.scope.own)

    def written(self) -> Map:
        return self._entry(here()).inner("nodes", here())

    @property
    def base(self) -> Map:
        return self._nodes_in(self.scope.base)

    def _nodes_in(self, layer: Map) -> Map:
        where = self.scope.where_of(self.name)
        return map_or_empty(map_or_empty(layer.get(self.name), where).get("nodes"), where)

    def _entry(self, where: Where) -> Map:
        """Its own entry, to be changed."""
        return self.scope.written().inner(self.name, where)

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
        entry = self._entry(where).inner("next", where)
        for key, value in values.items():
            if key not in self.carried_names():
                problems.add("repeat", where, f"{self.name} carries no {key!r}", nearest=self.carried_names())
            entry.put(key, self._value(f"{self.name}.next.{key}", value, None, where, problems), where)
        problems.raise_if_any()

    def carried_names(self) -> list[str]:
        return self.scope.outputs_of(self.name) or []

    def carried(self, part: str, key: str) -> str:
        """The link that `carry` or `next` gives for a name; empty where there is none yet."""
        return str((self.scope.entry(self.name).get(part) or {}).get(key, ""))

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

    def type_of(self, name: str) -> str:
        """Nothing is known of the file yet."""
        return ""


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


@contextlib.contextmanager
def _or_as_before(entry: Map) -> Iterator[None]:
    """Change a mapping, or leave it as it was where that raises GraphErrors."""
    before = entry.copy()
    try:
        yield
    except GraphErrors:
        entry.clear()
        entry.update(before)
        entry.lines = before.lines
        raise


def map_or_empty(value: Any, where: Where) -> Map:
    """A value that is a mapping, or an empty one in the place of any other."""
    return value if isinstance(value, Map) else Map(where)


def _one(name: str, value: Map) -> Map:
    result = Map(value.where)
    result.put(name, value, value.where)
    return result


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
