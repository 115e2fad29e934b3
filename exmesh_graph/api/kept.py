"""What code keeps from one call to the next: a node's result would then depend on what ran before it in its process.

Looked for in functions: what they change of names at a module's top, of imported modules, of classes and functions, of
default arguments, and what goes on by itself there (generators of numbers, iterators). A function that is only called
while modules are imported fills a table once; `unseen` tells which modules do so that a key does not hold.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from exmesh_graph.api.places import (
    DEFINED,
    FUNCTIONS,
    arguments,
    at_top,
    end_of,
    first_of,
    held,
    hooks,
    is_bound,
    is_set,
    locals_of,
    own,
    run_at_import,
    stores,
)
from exmesh_graph.graph.cache.syntax import imports_in
from exmesh_graph.pythontree import walk

_CHANGES = (
    "append add update setdefault pop popitem extend insert remove discard clear appendleft popleft extendleft rotate "
    "sort reverse put put_nowait get_nowait push write writelines seek truncate register move_to_end subtract set "
    "send difference_update intersection_update symmetric_difference_update fill itemset resize shuffle spawn jumped "
    "__setitem__ __delitem__ __setattr__ __iadd__ __next__ add_ mul_ copy_ fill_ zero_ sub_ div_ clamp_"
)
"""Methods that change what they belong to."""
_CHANGERS = (
    "setattr delattr next heappush heappop heapify heapreplace heappushpop shuffle insort insort_left insort_right "
    "copyto put place putmask setitem delitem iadd iconcat imul isub ior"
)  # functions that change their first argument
_GOES_ON = (
    "default_rng RandomState Generator PCG64 Random count cycle iter map filter zip Queue SimpleQueue LifoQueue "
    "StringIO BytesIO local"
)  # what they make is another after each use
_CHANGING, _CHANGERS_OF, _GOING_ON = (frozenset(text.split()) for text in (_CHANGES, _CHANGERS, _GOES_ON))
_AT_IMPORT = ("__init_subclass__", "__set_name__", "__prepare__", "__class_getitem__")
_WORDS = "what is kept from call to call ({})"


def kept_in(tree: ast.AST, package: str) -> dict[str, Any]:
    """What a module keeps, as JSON would hold it.

    `places` are [line, words, the function at the top or method that does it]; `inner` the names that stand in
    functions; `state` {name at the top: methods that change it}; `uses` [line, dotted name] of what functions take from
    modules of the pack; `hooked` the classes that note their subclasses; `acts` [line, dotted name, whether it is set]
    of what is changed, called or derived from while the module is imported.
    """
    if not isinstance(tree, ast.Module):
        return {}
    module = _Kept(tree, package)
    places = sorted(set(module.places()))
    return {"places": places, "inner": sorted(module.inner), "state": module.state, "uses": sorted(set(module.uses)),
            "hooked": module.hooked, "acts": sorted(set(module.acts()))}  # fmt: skip


def is_changed(state: Mapping[str, list[str]], name: str, rest: Sequence[str]) -> bool:
    """Whether `name.rest` of a module changes what its `state` holds under that name."""
    known = state.get(name)
    return known is not None and (known == ["*"] or any(part in _CHANGING or part in known for part in rest))


class _Kept:
    def __init__(self, tree: ast.Module, package: str) -> None:
        self.tree, self.top = tree, package.partition(".")[0]
        self.imported: dict[str, str] = {}
        self.altered: dict[int, set[str]] = {}
        for item in walk(tree):
            if isinstance(item, (ast.Import, ast.ImportFrom)):
                for alias, (module, name) in zip(item.names, imports_in(item, package), strict=True):
                    short = alias.asname or alias.name.partition(".")[0]
                    self.imported[short] = f"{module}.{name}" if name else module if alias.asname else short
        self.classes = {item.name: item for item in tree.body if isinstance(item, ast.ClassDef)}
        self.functions = {item.name: item for item in tree.body if isinstance(item, DEFINED)}
        self.hooked = sorted(name for name, item in self.classes.items() if hooks(item))
        self.values: dict[str, ast.expr | None] = {}
        for item in tree.body:
            self._bind(item)
        self.state = {name: self._methods(value) for name, value in self.values.items()}
        self.inner = set[str]()
        self.uses: list[tuple[int, str]] = []
        self.made = {end_of(call.func) for item in tree.body for call in run_at_import(item)}

    def _bind(self, statement: ast.stmt) -> None:
        for item in at_top(statement):
            if isinstance(item, ast.Assign):
                for target in item.targets:
                    self.values |= {part.id: item.value for part in walk(target) if is_bound(part)}
            elif isinstance(item, (ast.AnnAssign, ast.NamedExpr)) and isinstance(item.target, ast.Name):
                self.values[item.target.id] = item.value
            elif is_bound(item):
                self.values.setdefault(item.id, None)

    def _methods(self, value: ast.expr | None) -> list[str]:
        """Methods by which an object at the top of the module is changed, beside `_CHANGES`; `*` for any use."""
        end = end_of(value.func) if isinstance(value, ast.Call) else ""
        if end in _GOING_ON or isinstance(value, ast.GeneratorExp):
            return ["*"]
        methods = [m for m in getattr(self.classes.get(end), "body", ()) if isinstance(m, DEFINED) and m.args.args]
        return [m.name for m in methods if m.name != "__init__" and m.args.args[0].arg in self._altered(m)]

    def places(self) -> Iterator[tuple[int, str, str]]:
        for item in walk(self.tree):
            if isinstance(item, ast.ClassDef):
                meta = any(end_of(base) in ("type", "EnumMeta", "ABCMeta") for base in item.bases)
                for method in item.body:
                    if isinstance(method, DEFINED) and method.name not in _AT_IMPORT and not meta:
                        yield from self._of(method, f"{item.name}.{method.name}", {})
        for item in self.tree.body:
            for part in at_top(item):
                if isinstance(part, FUNCTIONS):
                    yield from self._of(part, getattr(part, "name", ""), {})

    def _of(
        self, function: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda, owner: str, around: dict[str, str]
    ) -> Iterator[tuple[int, str, str]]:
        """What one function keeps, and those in it. `around` says of local names what they stand for: "" for what is
        the call's own, a name at the top of the module, or `~` for what a function around holds."""
        names = {**around, **dict.fromkeys(arguments(function), "")}
        inside = list(own(function))
        shared = {name for item in inside if isinstance(item, ast.Global) for name in item.names}
        for item in inside:  # in the order of the text
            if isinstance(item, ast.Nonlocal) and owner.partition(".")[0] in self.made:
                yield item.lineno, _WORDS.format(", ".join(item.names)), ""
            for name, value in locals_of(item):
                names[name] = self._root(value, names) if value is not None and name not in shared else ""
        names = {name: of for name, of in names.items() if name not in shared}
        kept = held(function)
        for item in inside:
            self._note(item, names)
            if isinstance(item, ast.Global) and any(stores(part, item.names) for part in inside):
                yield item.lineno, _WORDS.format(f"global {', '.join(item.names)}"), owner
            for target in self._changed(item, names):
                root = self._root(target, names)
                if isinstance(target, ast.Name) and target.id in kept and names.get(target.id) == "":
                    yield target.lineno, _WORDS.format(f"the default of {target.id}"), owner
                elif root == "~":
                    if owner.partition(".")[0] in self.made:
                        yield target.lineno, _WORDS.format(ast.unparse(target)[:60]), ""
                elif root and (root not in self.imported or not isinstance(item, ast.Attribute) or is_set(item)):
                    yield target.lineno, _WORDS.format(ast.unparse(target)[:60]), owner
        below = {name: "~" if of == "" else of for name, of in names.items()}
        for item in inside:
            if isinstance(item, FUNCTIONS):
                yield from self._of(item, owner, below)

    def _note(self, item: ast.AST, names: dict[str, str]) -> None:
        if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Load) and names.get(item.id) is None:
            self.inner.add(item.id)
            self._use(item, names)
        elif isinstance(item, ast.Attribute):
            self.inner.add(f".{item.attr}")
            self._use(item, names)
        elif isinstance(item, ast.Constant) and isinstance(item.value, str) and item.value.isidentifier():
            self.inner.add(item.value)

    def _use(self, item: ast.expr, names: dict[str, str]) -> None:
        dotted = self._dotted(item)
        if dotted.partition(".")[0] == self.top and names.get(first_of(item)) is None:
            self.uses.append((item.lineno, dotted))

    def _dotted(self, item: ast.expr) -> str:
        """`a.b[c].d` by where `a` was imported from; an empty text for anything else."""
        parts = list[str]()
        while isinstance(item, (ast.Attribute, ast.Subscript, ast.Call)):
            parts += [item.attr] if isinstance(item, ast.Attribute) else []
            item = item.func if isinstance(item, ast.Call) else item.value
        root = self.imported.get(item.id, "") if isinstance(item, ast.Name) else ""
        return ".".join([root, *reversed(parts)]) if root else ""

    def acts(self) -> Iterator[tuple[int, str, bool]]:
        for item in walk(self.tree):
            for part in [*getattr(item, "bases", ()), *getattr(item, "decorator_list", ())]:
                if dotted := self._dotted(part):
                    yield part.lineno, dotted, False
        for statement in self.tree.body:
            for item in at_top(statement, classes=True):
                if isinstance(item, ast.Call) and end_of(item.func) in _CHANGERS_OF and item.args:
                    item, changed = item.args[0], True
                else:
                    item, changed = getattr(item, "func", item), is_set(item)
                if isinstance(item, (ast.Attribute, ast.Name)) and (dotted := self._dotted(item)):
                    yield item.lineno, f"{dotted}.*" if changed and not is_set(item) else dotted, changed

    def _changed(self, item: ast.AST, names: dict[str, str]) -> Iterator[ast.expr]:
        """The expressions that one piece of syntax changes in place."""
        if isinstance(item, (ast.Attribute, ast.Subscript)) and not isinstance(item.ctx, ast.Load):
            yield item.value
        elif isinstance(item, ast.Attribute):
            root = first_of(item.value)
            if item.attr in _CHANGING or (names.get(root) is None and item.attr in self.state.get(root, ())):
                yield item.value
        elif isinstance(item, ast.Name) and names.get(item.id) is None and self.state.get(item.id) == ["*"]:
            if isinstance(item.ctx, ast.Load):
                yield item
        elif isinstance(item, ast.Call):
            if end_of(item.func) in _CHANGERS_OF and item.args:
                yield item.args[0]
            elif isinstance(item.func, ast.Attribute) and item.func.attr in _CHANGING and first_of(item.func) in _TYPES:
                yield from item.args[:1]
            elif isinstance(item.func, ast.Name) and (known := self.functions.get(item.func.id)) is not None:
                changed = self._altered(known)
                yield from (one for one, name in zip(item.args, arguments(known), strict=False) if name in changed)
            yield from (word.value for word in item.keywords if word.arg == "out")

    def _altered(self, function: ast.AST) -> set[str]:
        """The names of what a function changes in place."""
        if id(function) not in self.altered:
            self.altered[id(function)] = {
                first_of(item.value) for item in walk(function)
                if isinstance(item, (ast.Attribute, ast.Subscript))
                and (is_set(item) or (isinstance(item, ast.Attribute) and item.attr in _CHANGING))
            }  # fmt: skip
        return self.altered[id(function)]

    def _root(self, item: ast.expr, names: dict[str, str]) -> str:
        """The name at the top of the module that an expression is, or is a part of; "" for what is the call's own."""
        while isinstance(item, (ast.Attribute, ast.Subscript, ast.Starred)):
            if isinstance(item, ast.Attribute) and item.attr == "__class__":
                return "__class__"
            item = item.value
        if isinstance(item, ast.Call):
            if isinstance(item.func, ast.Name) and item.func.id in ("type", "vars") and item.args:
                return "type" if item.func.id == "type" else self._root(item.args[0], names)
            name = first_of(item.func)
            if end_of(item.func) in ("getLogger", "current_thread", "main_thread"):
                return end_of(item.func)
            if name in self.functions and names.get(name) is None and isinstance(item.func, ast.Name):
                return name if _lends(self.functions[name], self.values) else ""
            return ""
        if not isinstance(item, ast.Name):
            return ""
        if item.id in names:
            return "cls" if item.id == "cls" and names["cls"] == "" else names[item.id]
        known = item.id in self.values or item.id in self.classes or item.id in self.functions
        return item.id if known or item.id in self.imported else ""


_TYPES = ("dict", "list", "set", "object", "type")


def _lends(function: Any, values: dict[str, Any]) -> bool:
    """Whether what a function gives outlives the call: it is cached, or a name at the top of the module."""
    cached = any(end_of(getattr(part, "func", part)) in ("cache", "lru_cache") for part in function.decorator_list)
    given = [first_of(item.value) for item in own(function) if isinstance(item, ast.Return) and item.value]
    return cached or any(name in values for name in given)
