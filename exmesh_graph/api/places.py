"""Where pieces of syntax stand: in a function's own body, at the top of a module; and what they bind there."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Any, TypeGuard

from exmesh_graph.pythontree import children, walk

DEFINED = (ast.FunctionDef, ast.AsyncFunctionDef)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def is_bound(item: ast.AST | None) -> TypeGuard[ast.Name]:
    return isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store)


def is_set(item: ast.AST) -> bool:
    return isinstance(item, (ast.Attribute, ast.Subscript)) and not isinstance(item.ctx, ast.Load)


def stores(item: ast.AST, names: list[str]) -> bool:
    bound = (
        [alias.asname or alias.name for alias in item.names] if isinstance(item, (ast.Import, ast.ImportFrom)) else []
    )
    bound += [item.name] if isinstance(item, (DEFINED, ast.ClassDef)) else []
    return (isinstance(item, ast.Name) and item.id in names and not isinstance(item.ctx, ast.Load)) or bool(
        {*bound} & {*names}
    )


def end_of(item: ast.AST | None) -> str:
    return item.attr if isinstance(item, ast.Attribute) else getattr(item, "id", "")


def first_of(item: ast.AST) -> str:
    while isinstance(item, (ast.Attribute, ast.Subscript)):
        item = item.value
    return getattr(item, "id", "") if isinstance(item, ast.Name) else ""


def hooks(item: ast.ClassDef) -> bool:
    return any(isinstance(part, DEFINED) and part.name == "__init_subclass__" for part in item.body) or any(
        word.arg == "metaclass" and end_of(word.value) not in ("ABCMeta", "EnumMeta") for word in item.keywords
    )


def arguments(function: Any) -> list[str]:
    args = function.args
    known = [*args.posonlyargs, *args.args, *args.kwonlyargs, args.vararg, args.kwarg]
    return [one.arg for one in known if one is not None]


def held(function: Any) -> set[str]:
    """Arguments whose default is an object that could be changed."""
    args = [*function.args.posonlyargs, *function.args.args]
    pairs = [*zip(args[len(args) - len(function.args.defaults) :], function.args.defaults, strict=True)]
    pairs += [*zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)]
    return {one.arg for one, value in pairs if isinstance(value, (ast.List, ast.Dict, ast.Set, ast.Call))}


def own(function: Any) -> Iterator[ast.AST]:
    """The syntax of a function's body but not that of functions in it, which themselves come; in the text's order."""
    body = function.body if isinstance(function.body, list) else [function.body]
    todo: list[ast.AST] = list(reversed(body))
    while todo:
        item = todo.pop()
        yield item
        if not isinstance(item, FUNCTIONS):
            todo += reversed(list(children(item)))


def at_top(statement: ast.AST, classes: bool = False) -> Iterator[ast.AST]:
    """What of a statement runs when its module is imported; functions themselves come, what is in classes if asked."""
    todo = [statement]
    while todo:
        item = todo.pop()
        yield item
        if not isinstance(item, FUNCTIONS) and (classes or not isinstance(item, ast.ClassDef)):
            todo += children(item)


def run_at_import(statement: ast.stmt) -> Iterator[ast.Call]:
    for item in at_top(statement):
        if isinstance(item, ast.Call):
            yield item
        for part in getattr(item, "decorator_list", ()):
            yield part if isinstance(part, ast.Call) else ast.Call(part, [], [])


def locals_of(item: ast.AST) -> Iterator[tuple[str, ast.expr | None]]:
    """(local name, what it is a name for; None for something new) that one piece of syntax binds."""
    if isinstance(item, ast.Assign) and len(item.targets) == 1 and isinstance(item.targets[0], ast.Name):
        yield item.targets[0].id, item.value
    elif isinstance(item, (ast.NamedExpr, ast.AnnAssign)) and isinstance(item.target, ast.Name):
        yield item.target.id, item.value
    elif isinstance(item, (ast.For, ast.comprehension)) and isinstance(item.target, ast.Name):
        yield item.target.id, item.iter
    elif isinstance(item, (ast.Import, ast.ImportFrom)):
        return  # what a function imports is no more its own than what its module does
    elif isinstance(item, (DEFINED, ast.ClassDef, ast.ExceptHandler)):
        yield item.name or "", None
    elif isinstance(item, (ast.Assign, ast.With, ast.AsyncWith, ast.AsyncFor, ast.For, ast.comprehension)):
        targets = item.targets if isinstance(item, ast.Assign) else [getattr(item, "target", None)]
        targets += [one.optional_vars for one in getattr(item, "items", ())]
        for target in filter(None, targets):
            yield from ((part.id, None) for part in walk(target) if is_bound(part))
