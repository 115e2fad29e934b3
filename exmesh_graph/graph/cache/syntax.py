"""Reading Python source for fingerprints: what a statement binds, uses, imports and does, and its normalised text."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator, Mapping

from exmesh_graph.pythontree import children, walk

Import = tuple[str, str | None]
"""(module, name imported from it); None for `import module` and `from module import *`."""

_HOMES = ("exmesh_graph", "exmesh_graph.graph", "exmesh_graph.graph.declare.node", "exmesh_graph.params")
_NAMED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.MatchAs, ast.MatchStar, ast.ExceptHandler)
_OURS = {f"{home}.{word}": word for home in _HOMES for word in ("node", "component", "param")}
LOADERS = ("import_module", "__import__")


def bound_by(statement: ast.stmt) -> Iterator[str]:
    """Module-level names that a top-level statement defines or changes; `import *` binds none that could be told."""
    if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        yield statement.name
        for item in _run(statement):  # in decorators, defaults and the bodies of classes
            yield from item.names if isinstance(item, ast.Global) else ()
            yield from [item.target.id] if isinstance(item, ast.NamedExpr) else ()
        return
    for item in walk(statement):
        yield from (name for name, _ in _bound(item, ""))
        if isinstance(item, (ast.Attribute, ast.Subscript)) and isinstance(item.ctx, ast.Store):
            base: ast.expr = item
            while isinstance(base, (ast.Attribute, ast.Subscript)):
                base = base.value
            if isinstance(base, ast.Name):
                yield base.id


def _bound(item: ast.AST, package: str) -> Iterator[tuple[str, str]]:
    """(name, its dotted origin where it is imported) that one piece of syntax binds."""
    if isinstance(item, _NAMED) and item.name:
        yield item.name, ""
    elif isinstance(item, ast.MatchMapping) and item.rest:
        yield item.rest, ""
    elif isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
        yield item.id, ""
    elif isinstance(item, (ast.Import, ast.ImportFrom)):
        for alias, (module, name) in zip(item.names, imports_in(item, package), strict=True):
            if alias.name != "*":
                short = alias.asname or alias.name.partition(".")[0]
                yield short, f"{module}.{name}" if name else module if alias.asname else short


def framework_names(tree: ast.AST, package: str) -> dict[str, str]:
    """{name: dotted origin} of what stands for something of this project and, in no scope, for anything else."""
    bound: dict[str, set[str]] = {}
    for item in walk(tree):
        for name, origin in [(item.arg, "")] if isinstance(item, ast.arg) else _bound(item, package):
            bound.setdefault(name, set()).add(origin)
    return {
        n: min(found) for n, found in bound.items() if len(found) == 1 and min(found).partition(".")[0] == _HOMES[0]
    }


def declaring(tree: ast.AST, names: Mapping[str, str]) -> set[int]:
    """The ids of the calls in `tree` that declare: the framework's own decorators, `param(...)` of a class's field."""

    def ours(call: ast.AST | None, words: tuple[str, ...]) -> bool:
        if not isinstance(call, ast.Call) or not isinstance(call.func, (ast.Name, ast.Attribute)):
            return False
        root, *rest = ast.unparse(call.func).split(".")
        return _OURS.get(".".join([names.get(root, ""), *rest])) in words

    found: set[int] = set()
    for item in walk(tree):
        found |= {id(part) for part in getattr(item, "decorator_list", ()) if ours(part, ("node", "component"))}
        for field in item.body if isinstance(item, ast.ClassDef) else ():
            if isinstance(field, ast.AnnAssign) and ours(field.value, ("param",)):
                found.add(id(field.value))
    return found


def used_by(statement: ast.AST, annotations: bool = True) -> Iterator[str]:
    """Names a statement may refer to; a string that spells a name counts (getattr), and all in quoted annotations."""
    todo = [statement]
    while todo:
        item = todo.pop()
        for field, value in ast.iter_fields(item):
            if field not in ("annotation", "returns") or annotations:
                todo += [part for part in (value if isinstance(value, list) else [value]) if isinstance(part, ast.AST)]
            for part in walk(value) if annotations and field in ("annotation", "returns") and value else ():
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield from re.findall(r"[^\W\d]\w*", part.value)
        if isinstance(item, ast.Name):
            yield item.id
        elif isinstance(item, ast.Constant) and isinstance(item.value, str) and item.value.isidentifier():
            yield item.value


def imports_in(tree: ast.AST, package: str) -> Iterator[Import]:
    """What is imported anywhere in `tree`, also by `importlib.import_module("text")`."""
    for item in walk(tree):
        if isinstance(item, ast.Import):
            for alias in item.names:
                yield alias.name, None
        elif isinstance(item, ast.ImportFrom):
            base = _absolute(item.module or "", item.level, package)
            for alias in item.names:
                yield base, None if alias.name == "*" else alias.name
        elif isinstance(item, ast.Call) and last_of(item.func) in LOADERS and (name := text_of(item)):
            yield _absolute(name.lstrip("."), len(name) - len(name.lstrip(".")), package), None


def _absolute(module: str, level: int, package: str) -> str:
    parts = package.split(".")
    return ".".join([*parts[: len(parts) - level + 1], *filter(None, [module])]) if level else module


def last_of(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def text_of(call: ast.Call) -> str:
    """The first argument, where it is a text that stands there."""
    first = call.args[0] if call.args else None
    return first.value if isinstance(first, ast.Constant) and isinstance(first.value, str) else ""


def acts(statement: ast.stmt, own: Collection[str], skipped: set[int]) -> bool:
    """Whether a top-level statement may change more than the names it binds when the module is imported.

    It calls, is decorated by or hands over something of the project (`own` names: registries, tables), calls for the
    effect, or changes a part of something, which may have other names. What is `skipped` only declares.
    """
    for item in _run(statement, skipped):
        called = [item.func] if isinstance(item, ast.Call) else getattr(item, "decorator_list", [])
        if isinstance(item, ast.Call) and last_of(item.func) != "field":
            called = [*called, *item.args, *(word.value for word in item.keywords)]
        if any(_root(part) in own for part in called if id(part) not in skipped):
            return True
        if isinstance(item, ast.AugAssign) or (isinstance(item, ast.Expr) and isinstance(item.value, ast.Call)):
            return True
        if isinstance(item, (ast.Attribute, ast.Subscript)) and not isinstance(item.ctx, ast.Load):
            return True
    return False


def _run(statement: ast.AST, skipped: Collection[int] = ()) -> Iterator[ast.AST]:
    """What of a statement runs when the module is imported."""
    todo = [statement]
    while todo:
        item = todo.pop()
        if isinstance(item, ast.Lambda) or id(item) in skipped:
            continue
        yield item
        if isinstance(item, (ast.FunctionDef, ast.AsyncFunctionDef)):
            todo += [*item.decorator_list, *item.args.defaults, *filter(None, item.args.kw_defaults)]
        else:
            todo += children(item)


def _root(part: ast.AST) -> str:
    while isinstance(part, (ast.Attribute, ast.Subscript, ast.Call, ast.Starred)):
        part = part.func if isinstance(part, ast.Call) else part.value
    return part.id if isinstance(part, ast.Name) else ""


def normalised(tree: ast.AST, names: Mapping[str, str], defaults: bool | None = None) -> str:
    """A text of the syntax tree that does not change with comments, docstrings or the Python version.

    `names` are those of `framework_names`. The `defaults` of `param(...)` count in a whole module and where code builds
    such an object itself; elsewhere the values are in the key.
    """
    out: list[str] = []
    _write(tree, out, isinstance(tree, ast.Module) if defaults is None else defaults, declaring(tree, names))
    return "".join(out)


_SKIPPED = frozenset({"ctx", "kind", "type_comment", "type_ignores"})


def _write(node: object, out: list[str], defaults: bool, own: set[int]) -> None:
    if isinstance(node, ast.AST):
        if isinstance(node, ast.Call) and id(node) in own:
            out.append("(param")
            if defaults:
                _write([*node.args, *(w for w in node.keywords if w.arg not in ("doc", "unit"))], out, defaults, own)
            out.append(")")
            return
        out.append("(" + node.__class__.__name__)
        for name in node._fields:
            value = getattr(node, name, None)
            if value is None or value == [] or name in _SKIPPED:
                if value is None and name == "value" and isinstance(node, ast.Constant):
                    out.append(" None")
                continue
            if name == "decorator_list":
                value = [item for item in value if id(item) not in own]
            elif name == "body" and isinstance(value, list):
                value = [item for item in value if not is_text(item)]
            if value:
                out.append(" " + name + "=")
                _write(value, out, defaults, own)
            elif not isinstance(value, list):
                out.append(f" {name}={value!r}")
        out.append(")")
    elif isinstance(node, list):
        out.append("[")
        for item in node:
            _write(item, out, defaults, own)
            out.append(",")
        out.append("]")
    else:
        out.append(repr(node))


def is_text(statement: ast.AST) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(getattr(statement.value, "value", None), str)
