"""Node types by family: `g.nodes.init.visual_hull(views=views.train)`. Editors read their types from families.pyi."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from exmesh_graph.api.judge import declared
from exmesh_graph.api.values import here

if TYPE_CHECKING:
    from exmesh_graph.api.scope import NodeScope
    from exmesh_graph.api.values import Node


class Families:
    """The families of node types, as attributes."""

    def __init__(self, scope: NodeScope) -> None:
        self._scope = scope

    def __getattr__(self, name: str) -> Family:
        if name.startswith("_"):
            raise AttributeError(name)
        return Family(self._scope, name)

    def __dir__(self) -> list[str]:
        return sorted({kind.partition(".")[0] for kind in self._scope.graph.packs.types})


class Family:
    """The types of one family, as functions that add a node. Its name comes first or as `name=`; default: the type's.

    Where a type has a parameter called `name`, that is meant by it.
    """

    def __init__(self, scope: NodeScope, family: str) -> None:
        self._scope, self._family = scope, family

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        kind = f"{self._family}.{name}"
        definition = declared(kind, self._scope.graph.packs, here())
        known = self._scope.graph.signature(kind)
        own_name = known is not None and ("name" in known.inputs or "name" in known.params.model_fields)

        def add(node_name: str = "", /, *given: Any, **fields: Any) -> Node:
            if not isinstance(node_name, str):
                self._scope._by_name((node_name,), kind)
            called = node_name or ("" if own_name else fields.pop("name", ""))
            return self._scope.add(called or _free(kind.rpartition(".")[2], self._scope), kind, *given, **fields)

        add.__name__, add.__doc__ = kind, definition.function.__doc__
        return add

    def __dir__(self) -> list[str]:
        types = self._scope.graph.packs.types
        return [kind.partition(".")[2] for kind in types if kind.startswith(f"{self._family}.")]


def _free(name: str, scope: NodeScope) -> str:
    """`name`, or `name_2` and so on where a node is called so."""
    number, free = 1, name
    while free in scope:
        number += 1
        free = f"{name}_{number}"
    return free
