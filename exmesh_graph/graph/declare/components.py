"""Components of a graph: small specs that plug into a solver node, such as a loss, an appearance or a light transport.

A component is declared as a class (see `node`). In a graph it is an entry like a node's, linked without a port:
`loss: "@smooth"`. It never runs and has no artifacts: the node receives the validated object; type, code, version and
parameters are part of the node's key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.declare.node import Component, NodeDef
from exmesh_graph.graph.declare.packs import current
from exmesh_graph.graph.declare.ports import component_ports, signature
from exmesh_graph.graph.problems import Where
from exmesh_graph.params import Params

MAX_NESTING = 32


@dataclass(frozen=True)
class BoundComponent:
    """A component of a graph: its validated object, and the components plugged into it, by field."""

    name: str
    definition: NodeDef
    value: Component
    nested: Mapping[str, BoundComponent]
    where: Where

    @property
    def depth(self) -> int:
        """How deep components nest here, itself counted."""
        return 1 + max((plug.depth for plug in self.nested.values()), default=0)

    def params(self, mode: str = "json") -> dict[str, Any]:
        """The parameters without the nested components."""
        return self.value.model_dump(mode=mode, exclude=set(component_ports(type(self.value))))

    def describe(self) -> dict[str, Any]:
        """Plain JSON-like data from which `rebuild` makes the same component elsewhere, and which people can read."""
        nested = {field: inner.describe() for field, inner in self.nested.items()}
        return {"type": self.definition.type, "params": in_order(self.params()), "components": nested}

    def all(self) -> list[BoundComponent]:
        """Itself and all components plugged into it."""
        return [self, *(inner for plug in self.nested.values() for inner in plug.all())]


def in_order(value: Any) -> Any:
    """Plain data with its mappings in the order of their names, as in the key: the order in a file is in no key."""
    if isinstance(value, Mapping):
        return {name: in_order(value[name]) for name in sorted(value)}
    return [in_order(item) for item in value] if isinstance(value, list) else value


def rebuild(name: str, told: Mapping[str, Any], where: Where) -> BoundComponent:
    """The component that `describe` told of; the node packs must be loaded."""
    nested = {field: rebuild(f"{name}.{field}", inner, where) for field, inner in told["components"].items()}
    definition = current().types[told["type"]]
    value = validated_again(definition, told["params"], {field: plug.value for field, plug in nested.items()}, where)
    assert isinstance(value, Component)
    return BoundComponent(name, definition, value, nested, where)


def validated_again(
    definition: NodeDef, told: Mapping[str, Any], nested: Mapping[str, Component], where: Where
) -> Params:
    """Parameters out of plain data. Raises GraphError where they are not what they were keyed by any more."""
    kind = signature(definition)
    value = kind.params.model_validate({**told, **nested})
    now = value.model_dump(mode="json", exclude=set(kind.inputs))
    names = ", ".join(sorted(name for name in {*now, *told} if now.get(name) != told.get(name)))
    if names:
        what = f"{definition.type}: a validator or serializer changes {names} each time it is applied"
        fix = "let the validator only check, and convert in the code that uses the parameter"
        raise GraphError(what, where=str(where), fix=fix)
    return value
