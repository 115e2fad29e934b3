"""The parameters of a graph or sub-graph as the page shows them, and values as one would write them."""

from __future__ import annotations

from typing import Any

from exmesh_graph.graph.language.spec import Tree
from exmesh_graph.studio.values import plain


def graph_parameters(tree: Tree, prefix: str = "") -> list[dict[str, Any]]:
    """PARAMETER for each parameter of a graph, or with a prefix of a sub-graph."""
    return [_declared(tree, name, prefix) for name in tree.declared]


def _declared(tree: Tree, name: str, prefix: str) -> dict[str, Any]:
    told, value = tree.declared[name], tree.params[name].value if name in tree.params else None
    limits = {sign: told.limits.get(sign) for sign in ("ge", "gt", "le", "lt")}
    kind = "number" if told.kind == "float" and told.inferred else told.kind
    return {
        "name": name, "type": kind, "value": plain(value), "text": text_of(value), "default": plain(told.default),
        "set": True, "unit": told.unit, "doc": told.doc, **limits, "multiple_of": None,
        "choices": [plain(choice) for choice in told.choices] or None, "optional": False, "required": told.required,
        "tuning": False, "auto": "", "reference": "", "rounds_differ": False, "target": f"{prefix}{name}",
        "path": told.kind == "path",
    }  # fmt: skip


def text_of(value: Any) -> str:
    """A value as one would write it into a graph file."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    told = plain(value)
    return told if isinstance(told, str) else str(told)
