"""What is known to be wrong with a node that was just added, by the checks of graph files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from exmesh_graph.api.values import Plug
from exmesh_graph.graph.declare.components import Component
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.nodecheck import NodeCheck
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.language.wires import Wiring
from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where, fail, nearest

if TYPE_CHECKING:
    from exmesh_graph.api.scope import NodeScope
    from exmesh_graph.graph.declare.node import NodeDef
    from exmesh_graph.graph.declare.packs import Packs

_OWN = (
    "type",
    "every",
    "at",
    "each",
    "limits",
    "bypass",
    "doc",
    "seed",
)  # of a node's entry, what is neither port nor parameter


def judge(scope: NodeScope, name: str) -> Problems:
    """The faults of one node; links that lead nowhere yet, and values with graph parameters in them, are left out."""
    kind, problems = scope.type_of(name), Problems()
    if not kind or "${" in kind:
        return problems
    entry = scope.own[name]
    specs = _neighbours(scope, name)
    known = scope.graph.signature(kind)
    names = set() if known is None else {*known.inputs, *known.params.model_fields, *known.renamed}
    fields: dict[str, Value] = {}
    for key, value in entry.items():
        if key in _OWN:
            continue
        judged: Any = value
        if isinstance(value, str) and value.startswith("@@"):
            judged = value[1:]
        elif "${" in repr(value):
            judged = Broken()
        elif isinstance(value, str) and value.startswith("@"):
            judged = Broken() if "[*]" in value else _link(scope, value, specs)
        elif isinstance(value, list) and any(isinstance(item, str) and item.startswith("@") for item in value):
            judged = [_link(scope, item, specs) if isinstance(item, str) else item for item in value]
            judged = Broken() if "[*]" in str(value) else judged
        if isinstance(judged, Broken) and key in names:
            continue
        fields[key] = Value(judged, entry.lines[key], entry.lines[key].base)
    specs[name] = NodeSpec(name, kind, fields, entry.where, 0, each=_each(entry))
    return _check_part(Unrolled(scope.graph.name, scope.graph.file, specs, {}, {}), name, scope.graph.packs)


def _check_part(graph: Unrolled, name: str, packs: Packs) -> Problems:
    """What is wrong with the type, wires and values of one node of a graph still being written; what it lacks is not.

    Wires may only lead to nodes of `graph`; what is wired elsewhere is Broken.
    """
    problems = Problems()
    wiring = Wiring(graph, packs, problems)
    if name in wiring.signatures:
        NodeCheck(name, wiring, whole=False).params({})
    return problems


def declared(kind: Any, packs: Packs, where: Where) -> NodeDef:
    """The type of a name, or the one that a function or class declares. Raises GraphErrors."""
    definition = packs.find(kind) if isinstance(kind, str) else None
    for other in packs.types.values():
        definition = other if other.function is kind else definition
    if definition is None:
        shown = kind if isinstance(kind, str) else getattr(kind, "__qualname__", repr(kind))
        near, fix = nearest(str(shown), packs.types), "exmesh nodes lists all types; @node or @component declares one"
        fail("node-type", where, f"there is no node type {shown!r}", nearest=near, fix=fix)
    return definition


def plug_of(value: Any, packs: Packs, where: Where) -> Plug[Any] | None:
    """What `component(...)` would give for a component, as Plug or as an object; None for any other value."""
    if isinstance(value, Component):
        return Plug(
            declared(type(value), packs, where).type, {key: getattr(value, key) for key in value.model_fields_set}
        )
    return value if isinstance(value, Plug) else None


def _neighbours(scope: NodeScope | None, name: str) -> dict[str, NodeSpec]:
    """The nodes in sight, without what they are wired to."""
    specs: dict[str, NodeSpec] = {}
    while scope is not None:
        for other in scope:
            kind = scope.type_of(other)
            if other != name and scope.graph.packs.find(kind) is not None:
                each = _each(scope.entry(other))
                specs.setdefault(other, NodeSpec(other, kind, {}, scope.where_of(other), 0, each=each))
        scope = scope.outer
    return specs


def _link(scope: NodeScope, text: str, specs: dict[str, NodeSpec]) -> Link | Broken:
    """The output that a link leads to, its node among `specs`; Broken where that is not known yet."""
    source = scope.source(text)
    if source is None:
        return Broken()
    name, home, port = source
    kind = home.type_of(name)
    if home.graph.packs.find(kind) is None:
        return Broken()
    shown = name if home.outer is None or home == scope else f"{home.name}.{name}"
    specs.setdefault(shown, NodeSpec(shown, kind, {}, home.where_of(name), 0, each=_each(home.entry(name))))
    return Link(shown, port)


def _each(entry: Map) -> Value | None:
    """What a node's entry says of `each`."""
    return Value(entry["each"], entry.lines["each"], entry.lines["each"].base) if "each" in entry else None
