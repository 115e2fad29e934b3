"""Whether an expression can have but one value whatever the inputs are: a constant, or what is put together of these.

Names of one function are followed through its assignments; what calls anything else than path and text functions,
or holds an argument, may vary.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping

from exmesh_graph.pythontree import children, walk

_JOINING = {
    "Path", "PurePath", "PosixPath", "PurePosixPath", "str", "fspath", "join", "joinpath", "format", "with_name",
    "with_suffix", "normpath", "abspath", "resolve", "absolute", "lower", "upper", "strip", "replace", "decode",
    "encode", "bytes", "chr", "sorted", "list", "tuple", "next", "iter", "getattr",
}  # fmt: skip


class Fixed:
    """Called with an expression of a module: whether no argument of a function can change it."""

    def __init__(self, tree: ast.AST, imported: Mapping[str, str]) -> None:
        self._imported = imported
        self._defined = {one.name for one in getattr(tree, "body", ()) if isinstance(one, _DEFINED)}
        self._scope: dict[int, dict[str, list[ast.expr | None]]] = {}  # of each expression's function
        self._enter(tree, {})

    def __call__(self, item: ast.AST) -> bool:
        return self._fixed(item, self._scope.get(id(item), {}), 0)

    def text(self, item: ast.expr) -> str | None:
        """The text that an expression is; None where it is none that stands there."""
        return self._text(item, self._scope.get(id(item), {}), 0)

    def _enter(self, tree: ast.AST, around: Mapping[str, list[ast.expr | None]]) -> None:
        own: dict[str, list[ast.expr | None]] = {}
        arguments = getattr(tree, "args", None)
        if isinstance(arguments, ast.arguments):
            given = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
            own |= {one.arg: [None] for one in given if one is not None}
            last = [*arguments.posonlyargs, *arguments.args][-len(arguments.defaults) :] if arguments.defaults else []
            defaults = [*zip(last, arguments.defaults, strict=True)]
            defaults += [(k, v) for k, v in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True) if v]
            own |= {one.arg: [value] for one, value in defaults if isinstance(value, ast.Constant) and _is_text(value)}
        inside = list(_inside(tree))
        for item in inside:
            for name, value in _assigned(item):
                own.setdefault(name, []).append(value)
        scope = {**around, **own}
        for item in inside:
            self._scope[id(item)] = scope
            if isinstance(item, _FUNCTIONS):
                self._enter(item, scope)

    def _fixed(self, item: ast.AST, scope: Mapping[str, list[ast.expr | None]], depth: int) -> bool:
        if depth > 12:
            return False
        if isinstance(item, ast.Name):
            if item.id in scope:
                return all(value is not None and self._fixed(value, scope, depth + 1) for value in scope[item.id])
            return item.id in self._imported or item.id in self._defined
        if isinstance(item, ast.Call):
            end = item.func.attr if isinstance(item.func, ast.Attribute) else getattr(item.func, "id", "")
            parts: list[ast.AST] = [*item.args, *(word.value for word in item.keywords)]
            if isinstance(item.func, ast.Attribute):
                parts.append(item.func.value)
            return end in _JOINING and all(self._fixed(part, scope, depth + 1) for part in parts)
        if isinstance(item, (_FUNCTIONS, ast.Await, ast.Yield, ast.YieldFrom, ast.comprehension)):
            return False
        parts = [part for part in children(item) if isinstance(part, ast.expr)]
        return all(self._fixed(part, scope, depth + 1) for part in parts)

    def _text(self, item: ast.expr, scope: Mapping[str, list[ast.expr | None]], depth: int) -> str | None:
        if isinstance(item, ast.Constant):
            return item.value if isinstance(item.value, str) else None
        if isinstance(item, ast.Name) and depth < 4 and len(values := scope.get(item.id, [])) == 1:
            return None if values[0] is None else self._text(values[0], scope, depth + 1)
        return None


_DEFINED = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def _is_text(value: ast.Constant) -> bool:
    return isinstance(value.value, str) and bool(value.value)


def _inside(tree: ast.AST) -> Iterator[ast.AST]:
    """All syntax of a function but not that of functions in it; these themselves are told."""
    todo = list(children(tree))
    while todo:
        item = todo.pop()
        yield item
        if not isinstance(item, _FUNCTIONS):
            todo += children(item)
        else:
            todo += [*getattr(item, "decorator_list", ()), *item.args.defaults, *filter(None, item.args.kw_defaults)]


def _assigned(item: ast.AST) -> Iterator[tuple[str, ast.expr | None]]:
    """(name, the value it gets) of one piece of syntax; None for a value that may vary."""
    if isinstance(item, ast.Assign):
        for target in item.targets:
            yield from _targets(target, item.value)
    elif isinstance(item, (ast.AnnAssign, ast.NamedExpr, ast.AugAssign)) and item.value is not None:
        yield from _targets(item.target, item.value)
    elif isinstance(item, (ast.For, ast.AsyncFor, ast.comprehension)):
        yield from _targets(item.target, item.iter)
    elif isinstance(item, ast.withitem) and item.optional_vars is not None:
        yield from _targets(item.optional_vars, item.context_expr)
    elif isinstance(item, (ast.ExceptHandler, ast.MatchAs, ast.MatchStar)) and item.name:
        yield item.name, None
    elif isinstance(item, ast.MatchMapping) and item.rest:
        yield item.rest, None


def _targets(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, ast.expr | None]]:
    for part in walk(target):
        if isinstance(part, ast.Name):
            yield part.id, value
