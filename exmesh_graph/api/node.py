"""A node of a graph that is built in Python, as code that wires it sees it: its outputs are its attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from exmesh_graph.api.values import Wire, here
from exmesh_graph.graph.problems import GraphErrors, Problem, nearest

if TYPE_CHECKING:
    from exmesh_graph.api.scope import NodeScope


class UnknownPort(GraphErrors, AttributeError):
    """A node was asked for an output that it does not have."""


class Node:
    """A node of a graph; its outputs are its attributes: `views.train`, or `views["train"]`. Made by `add`."""

    def __init__(self, scope: NodeScope, name: str) -> None:
        self._scope, self._name = scope, name

    def __getattr__(self, port: str) -> Wire[Any]:
        if port.startswith("_"):
            raise AttributeError(port)
        return self[port]

    def __getitem__(self, port: str) -> Wire[Any]:
        known = self._scope.outputs_of(self._name)
        kind = self._scope.graph.signature(self._scope.type_of(self._name))
        if known is not None and port not in known and not (kind and port in kind.renamed_outputs):
            what = f"{self._name} ({self._scope.type_of(self._name)}) has no output {port!r}"
            fix = "" if known else "a component has none: give the component itself"
            problem = Problem("unknown-port", here(), what, expected=", ".join(known), fix=fix,
                              nearest=tuple(nearest(port, known) or known))  # fmt: skip
            raise UnknownPort([problem])
        return Wire(self._scope, self._name, port)

    __iter__ = None  # it has names, no order

    def __dir__(self) -> list[str]:
        return list(self._scope.outputs_of(self._name) or ())

    def __str__(self) -> str:
        return f"@{self._name}"

    def __repr__(self) -> str:
        outputs = ", ".join(self._scope.outputs_of(self._name) or ())
        return f"<{self._scope.type_of(self._name)} {self._name}{': ' + outputs if outputs else ''}>"
