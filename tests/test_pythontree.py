"""Walks over syntax trees: those of `ast`, less contexts and operators."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from exmesh_graph.pythontree import children, walk

LEFT_OUT = (ast.expr_context, ast.operator, ast.boolop, ast.unaryop, ast.cmpop)
SOURCES = [*sorted((Path(__file__).parents[1] / "exmesh_graph" / "graph").rglob("*.py"))[::4], Path(__file__)]
EVERYTHING = """
@d(1, *a, k=v, **kw)
async def f(a: int, /, b=1, *c, d: str = "x", **e) -> None:
    global g
    async with a as b, c: await b
    async for x in y: yield x
    else: return (yield from z)
    nonlocal_ = lambda q=1, *r: q if r else not q
    try: raise E from e
    except* (A, B) as n: pass
    finally: del a.b, c[1:2, ::3]
    match p:
        case {"k": 1, **rest} | [A(x, y=2), *_] if x < y <= 3 and z: x: int = -1
        case None | _ as w: x @= ~y
    return f"{a!r:>{b}}", {**a, 1: 2}, {i for i in j if k}, {i: 1 for i in j}, [*a], (n := 1), ...
"""


@pytest.mark.parametrize("text", [EVERYTHING, *(path.read_text(encoding="utf-8") for path in SOURCES)])
def test_the_nodes_and_their_order_are_those_of_ast(text: str) -> None:
    tree = ast.parse(text)
    expected = [item for item in ast.walk(tree) if not isinstance(item, LEFT_OUT)]
    assert list(map(id, walk(tree))) == list(map(id, expected))
    assert list(map(id, walk(tree))) == list(map(id, expected))  # also from what was noted
    for item in expected:
        below = [part for part in ast.iter_child_nodes(item) if not isinstance(part, LEFT_OUT)]
        assert list(map(id, children(item))) == list(map(id, below))


def test_what_is_noted_is_no_part_of_the_text() -> None:
    tree, other = ast.parse(EVERYTHING), ast.parse(EVERYTHING)
    walk(tree)
    assert ast.dump(tree) == ast.dump(other)
    assert ast.unparse(tree) == ast.unparse(other)
