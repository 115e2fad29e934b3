"""What tests of patches ask a patched graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from exmesh_graph.graph.language.check import Checked

Patched = Callable[..., Checked]
Refusal = Callable[..., Any]


def wires(graph: Checked) -> dict[str, str]:
    return {f"{n}.{port}": str(link)[1:] for n, bound in graph.nodes.items() for port, link in bound.inputs.items()}


def value(graph: Checked, node: str, name: str) -> Any:
    return getattr(graph.nodes[node].params, name)
