"""Walks over Python's syntax trees that nobody changes: of hundreds of modules, each some ten times."""

from __future__ import annotations

import ast

_LEAVES = frozenset({"ctx", "op", "ops", "id", "attr", "arg", "kind", "conversion", "type_comment", "type_ignores"})
"""Fields whose nodes nobody asks for (contexts, operators), or that hold none."""


def walk(tree: ast.AST) -> list[ast.AST]:
    """`tree` and all below it, in the order of `ast.walk`, but without contexts and operators."""
    items = [tree]
    for item in items:  # which grows meanwhile
        items += children(item)
    return items


def children(item: ast.AST) -> list[ast.AST]:
    """What stands directly below, in the order of `ast.iter_child_nodes`, but without contexts and operators.

    It is found once and noted on the node: neither the list nor the tree may be changed afterwards.
    """
    held = item.__dict__
    below = held.get("_below")
    if below is None:
        below = held["_below"] = _below(item)
    return below


def _below(item: ast.AST) -> list[ast.AST]:
    held, below = item.__dict__, list[ast.AST]()
    for name in item._fields:
        if name not in _LEAVES:
            value = held.get(name)
            if value.__class__ is list:
                below += [part for part in value if isinstance(part, ast.AST)]
            elif isinstance(value, ast.AST):
                below.append(value)
    return below
