"""Reading Python source for fingerprints: what a statement binds, uses, imports and does, and its normalised text."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

Import = tuple[str, str | None]
"""(module, name imported from it); None for `import module` and `from module import *`."""


def bound_by(statement: ast.stmt) -> Iterator[str]:
    """Module-level names that a top-level statement defines or changes."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield statement.name
        return
    for item in ast.walk(statement):
        if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield item.name
        elif isinstance(item, ast.Import | ast.ImportFrom):
            for alias in item.names:
                yield (alias.asname or alias.name).partition(".")[0]
        elif isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
            yield item.id
        elif isinstance(item, ast.Attribute | ast.Subscript) and isinstance(item.ctx, ast.Store):
            base: ast.expr = item
            while isinstance(base, ast.Attribute | ast.Subscript):
                base = base.value
            if isinstance(base, ast.Name):
                yield base.id


def used_by(statement: ast.stmt) -> Iterator[str]:
    """Names a statement may refer to; a string that spells a name counts (getattr), and all in quoted annotations."""
    for item in ast.walk(statement):
        for field in ("annotation", "returns"):
            for part in ast.walk(getattr(item, field, None) or ast.Pass()):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield from re.findall(r"[^\W\d]\w*", part.value)
        if isinstance(item, ast.Name):
            yield item.id
        elif isinstance(item, ast.Constant) and isinstance(item.value, str) and item.value.isidentifier():
            yield item.value


def imports_in(tree: ast.AST, package: str) -> Iterator[Import]:
    for item in ast.walk(tree):
        if isinstance(item, ast.Import):
            for alias in item.names:
                yield alias.name, None
        elif isinstance(item, ast.ImportFrom):
            base = item.module or ""
            if item.level:
                parts = package.split(".")
                parent = parts[: len(parts) - item.level + 1]
                base = ".".join([*parent, base] if base else parent)
            for alias in item.names:
                yield base, None if alias.name == "*" else alias.name


def acts(statement: ast.stmt, own: set[str]) -> bool:
    """Whether a top-level statement may change more than the names it binds when the module is imported.

    It calls or is decorated by something of the project (`own` names: registries, tables), or calls for the effect.
    """
    todo: list[ast.AST] = [statement]
    while todo:
        item = todo.pop()
        if isinstance(item, ast.Lambda):
            continue
        called = [item.func] if isinstance(item, ast.Call) else getattr(item, "decorator_list", [])
        if any(_root(part) in own for part in called):
            return True
        if isinstance(item, ast.Expr) and isinstance(item.value, ast.Call):
            return True
        if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            todo += [*item.decorator_list, *item.args.defaults, *filter(None, item.args.kw_defaults)]
        else:
            todo += ast.iter_child_nodes(item)
    return False


def _root(part: ast.AST) -> str:
    while isinstance(part, ast.Attribute | ast.Subscript | ast.Call):
        part = part.func if isinstance(part, ast.Call) else part.value
    return part.id if isinstance(part, ast.Name) else ""


def normalised(tree: ast.AST) -> str:
    """A text of the syntax tree that does not change with comments, docstrings or the Python version.

    Of a whole module the defaults of `param(...)` count, since code may build such an object itself.
    """
    out: list[str] = []
    _write(tree, out, isinstance(tree, ast.Module))
    return "".join(out)


_SKIPPED = frozenset({"ctx", "kind", "type_comment", "type_ignores"})


def _write(node: object, out: list[str], defaults: bool) -> None:
    if isinstance(node, ast.AST):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "param":
            out.append("(param")
            if defaults:
                _write([*node.args, *(w for w in node.keywords if w.arg not in ("doc", "unit"))], out, defaults)
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
                value = [item for item in value if not is_node_decorator(item)]
            elif name == "body" and isinstance(value, list):
                value = [item for item in value if not is_text(item)]
            if value:
                out.append(" " + name + "=")
                _write(value, out, defaults)
            elif not isinstance(value, list):
                out.append(f" {name}={value!r}")
        out.append(")")
    elif isinstance(node, list):
        out.append("[")
        for item in node:
            _write(item, out, defaults)
            out.append(",")
        out.append("]")
    else:
        out.append(repr(node))


def is_text(statement: ast.AST) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(getattr(statement.value, "value", None), str)


def is_node_decorator(item: ast.AST) -> bool:
    if not isinstance(item, ast.Call):
        return False
    name = item.func.attr if isinstance(item.func, ast.Attribute) else getattr(item.func, "id", "")
    return name in ("node", "component")
