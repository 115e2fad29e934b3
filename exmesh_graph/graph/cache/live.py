"""Fingerprints of what a script or a notebook defines: the module `__main__`, whose text is in no importable file.

A function counts by the text of its definition, taken from the script or from the cell that defined it, by its defaults
and closure, and by all module-level names that it uses, recursively: functions and classes of `__main__` in the same
way, values by their contents, other project modules by their text (see `fingerprint`). Each counts as it is now, so
that a helper defined again in another cell, or a constant that was changed, changes the key. What cannot be told by
its contents is refused; nothing is left out in silence.
"""

from __future__ import annotations
import __future__

import ast
import copyreg
import dataclasses
import dis
import enum
import functools
import hashlib
import inspect
import linecache
import re
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pydantic.fields import FieldInfo

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.syntax import Import, imports_in, normalised

MAIN = "__main__"
_HIDING = ("globals", "eval", "exec")
_DUNDER = re.compile(r"__\w+__\Z|_abc_impl\Z")
_SUNDER = re.compile(r"_\w+_\Z")  # of an Enum, made by Python
_TUPLE = ("_fields", "_field_defaults", "_replace", "_make", "_asdict")
_FUTURE = sum({getattr(__future__, name).compiler_flag for name in __future__.all_feature_names})
_COLLECTIONS = (list, tuple, set, frozenset, dict, types.MappingProxyType)
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(...), type(NotImplemented))


class Live:
    """The parts of one definition of `__main__`: {name: digest}, and what its code imports."""

    def __init__(self, target: Callable[..., Any]) -> None:
        self.target = target.__qualname__
        self.parts: dict[str, str] = {}
        self.imports: list[Import] = []
        self._open: list[int] = []  # what is being told, outermost first
        self.parts[f"{MAIN}:{self.target}"] = self._told(target, self.target)

    def _told(self, value: Any, place: str) -> str:
        """The digest of a value: equal for equal contents, in this process or another."""
        return hashlib.sha256(repr(self._shape(value, place)).encode("utf-8", "surrogatepass")).hexdigest()

    def _shape(self, value: Any, place: str) -> Any:
        """Plain nested tuples of strings that say all there is to a value."""
        if type(value) in _PLAIN:
            return type(value).__name__, repr(value)
        if id(value) in self._open:
            return "again", len(self._open) - self._open.index(id(value))
        self._open.append(id(value))
        tell = next((tell for kinds, tell in _TELLERS if isinstance(value, kinds)), Live._instance)
        shape = (Live._collection if type(value) in _COLLECTIONS else tell)(self, value, place)
        self._open.pop()
        return shape

    # --- code

    def _function(self, function: types.FunctionType, place: str) -> Any:
        if function.__globals__ is not vars(sys.modules[MAIN]):
            home, name = str(function.__globals__.get("__name__")), function.__code__.co_qualname
            there, named = self._reference(home, name), _named(home, name)
            if named is function:
                return there
            if named is not None and inspect.unwrap(getattr(named, "__func__", named)) is not function:
                raise self._outlived(place, home)
            return "wrapper", there, self._bound_to(function, place)
        definition, inside = _definition(function)
        self.imports += [*imports_in(definition, ""), *_modules_in(definition)]
        text = normalised(definition, _framework_names(definition)), inside
        return "function", text, self._bound_to(function, place), self._names(function.__code__, place)

    def _bound_to(self, function: types.FunctionType, place: str) -> Any:
        """What a function got when it was made: defaults, closure, annotations."""
        free = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        cells = [(name, self._shape(_content(cell), f"{place}, in {name}")) for name, cell in free]
        given = (function.__defaults__, function.__kwdefaults__)
        hints = {name: self._annotation(hint, place) for name, hint in inspect.get_annotations(function).items()}
        return self._shape(given, place), cells, sorted(hints.items())

    def _names(self, code: types.CodeType, place: str) -> Any:
        """The module-level names that code uses, and what they stand for now."""
        space = vars(sys.modules[MAIN])
        for name in sorted(set(_globals_of(code))):
            if name in _HIDING and name not in space:
                what = f"{place}: it calls {name}(), which hides what its result depends on"
                raise GraphError(what, where=self.target, fix="name what it uses, or move the node into a module")
            if name in space:
                self._name(name, space[name])
        return sorted(set(_globals_of(code)))

    def _name(self, name: str, value: Any) -> None:
        part = f"{MAIN}:{name}"
        if part not in self.parts and name != self.target:
            self.parts[part] = "..."
            outside, self._open = self._open, []
            self.parts[part] = self._told(value, name)
            self._open = outside

    def _annotation(self, hint: Any, place: str) -> Any:
        hint = getattr(hint, "__forward_arg__", hint)
        if not isinstance(hint, str):
            return self._shape(hint, place)
        for name in re.findall(r"[^\W\d]\w*", hint):
            if name in vars(sys.modules[MAIN]):
                self._name(name, vars(sys.modules[MAIN])[name])
        return "text", hint

    def _class(self, cls: type, place: str) -> Any:
        if cls.__module__ != MAIN:
            if _named(cls.__module__, cls.__qualname__) not in (cls, None):
                raise self._outlived(place, cls.__module__)
            return self._reference(cls.__module__, cls.__qualname__)
        own = {name: self._shape(value, f"{place}.{name}") for name, value in _attributes(cls)}
        if issubclass(cls, enum.Enum):
            own["members"] = [(name, self._shape(member.value, place)) for name, member in cls.__members__.items()]
        if dataclasses.is_dataclass(cls):
            made_by = [(f.name, self._shape(_default(f), place)) for f in dataclasses.fields(cls)]
            own["fields"] = repr(cls.__dataclass_params__), made_by  # type: ignore[attr-defined]
        if issubclass(cls, tuple):
            own["fields"] = self._shape(getattr(cls, "_field_defaults", None), place)
        hints = {name: self._annotation(hint, place) for name, hint in inspect.get_annotations(cls).items()}
        bases = [self._shape(base, place) for base in getattr(cls, "__orig_bases__", cls.__bases__)]
        return "class", cls.__qualname__, bases, sorted(hints.items()), sorted(own.items())

    def _reference(self, module: str, name: str) -> Any:
        """Something that a module defines: its text counts if it is the project's (see `fingerprint`)."""
        if module != MAIN:
            self.imports.append((module, name.partition(".")[0] or None))
        return "import", module, name

    def _outlived(self, place: str, module: str) -> GraphError:
        what = f"{place} is not what the module {module} calls so now, which was loaded anew"
        return GraphError(what, where=f"the node function {self.target}", fix=f"import it from {module} again")

    def _module(self, module: types.ModuleType, place: str) -> Any:
        self.imports.append((module.__name__, None))
        return "module", module.__name__

    def _wrapped(self, value: Any, place: str) -> Any:
        inner = value.__wrapped__ if isinstance(value, functools._lru_cache_wrapper) else value.__func__
        return type(value).__name__, self._shape(inner, place)

    def _property(self, value: property, place: str) -> Any:
        return "property", [self._shape(part, place) for part in (value.fget, value.fset, value.fdel)]

    # --- values

    def _collection(self, value: Any, place: str) -> Any:
        """Sets in an order of their own; what is in a mapping has its key in its place."""
        items: list[Any] = []
        if isinstance(value, Mapping):
            items = [(self._shape(k, place), self._shape(v, f"{place}[{k!r}]"[:60])) for k, v in value.items()]
        else:
            items = [self._shape(item, place) for item in value]
        return type(value).__name__, sorted(map(repr, items)) if isinstance(value, set | frozenset) else items

    def _field(self, value: Any, place: str) -> Any:
        return "field"  # a limit of a parameter, whose validated value is in the key

    def _instance(self, value: Any, place: str) -> Any:
        """Anything else, methods too: arrays by their bytes, others by what copying them would take."""
        kind = type(value)
        if kind.__module__ == "torch" and hasattr(value, "detach"):
            flat = value.detach().cpu().contiguous().reshape(-1).view(sys.modules["torch"].uint8)
            return "tensor", str(value.dtype), tuple(value.shape), hashlib.sha256(flat.numpy()).hexdigest()
        if kind.__module__ == "numpy" and kind.__name__ == "ndarray" and not value.dtype.hasobject:
            return "array", str(value.dtype.descr), value.shape, hashlib.sha256(value.tobytes()).hexdigest()
        try:
            told = copyreg.dispatch_table.get(kind, lambda it: it.__reduce_ex__(4))(value)
        except Exception:  # whatever a class raises that cannot be copied
            told = None
        if isinstance(told, str):
            return self._reference(getattr(value, "__module__", None) or kind.__module__, told)
        if told is not None and kind is not object:
            make, arguments, *state = told
            parts = [make, arguments, *(list(part) if isinstance(part, Iterator) else part for part in state)]
            return "made", [self._shape(part, place) for part in parts]
        raise GraphError(
            f"its code uses {place}, a {kind.__module__}.{kind.__qualname__}, whose contents cannot be part of a key",
            where=f"the node function {self.target}",
            expected="numbers, texts, paths, arrays, dataclasses, functions, classes, and collections of these",
            fix=f"make {place} inside the function, pass it as a parameter or an input, or move the node into a module",
        )


_TELLERS: tuple[tuple[Any, Callable[[Live, Any, str], Any]], ...] = (
    (types.FunctionType, Live._function),
    (type, Live._class),
    (types.ModuleType, Live._module),
    (property, Live._property),
    ((staticmethod, classmethod, functools._lru_cache_wrapper), Live._wrapped),
    (typing.ForwardRef, Live._annotation),
    (FieldInfo, Live._field),
)


def _attributes(cls: type) -> Iterator[tuple[str, Any]]:
    """What the body of a class defines, without what Python, dataclasses, pydantic and typing make of it."""
    for name, value in vars(cls).items():
        function = value if isinstance(value, types.FunctionType) else None
        if function is not None and function.__code__.co_filename == "<string>":
            continue
        if _DUNDER.match(name) and (function is None or function.__globals__ is not vars(sys.modules[MAIN])):
            continue
        if issubclass(cls, enum.Enum) and (_SUNDER.match(name) or isinstance(value, cls)):
            continue
        if issubclass(cls, tuple) and (name in _TUPLE or type(value).__name__ == "_tuplegetter"):
            continue
        if not isinstance(value, types.MemberDescriptorType | types.GetSetDescriptorType):  # __slots__, __dict__
            yield name, value


def _definition(function: types.FunctionType) -> tuple[ast.AST, Any]:
    """The syntax tree of a function's definition, from the very text that was compiled.

    Of a lambda it is that of its whole statement, and the places of its instructions in it.
    """
    code = function.__code__
    tree = None
    for fresh in (False, True):
        if fresh:
            linecache.checkcache(code.co_filename)
        text = "".join(linecache.getlines(code.co_filename))
        tree = tree or _tree_with(code, text)
    if tree is None:
        why = "was changed after it ran" if text else "is not kept"
        raise GraphError(f"the source of {function.__qualname__} in {code.co_filename} {why}: no key can be made of it",
                         fix="run the script or the cell again, or move the node into a module")  # fmt: skip
    for item in ast.walk(tree):
        if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            first = min([item.lineno, *(part.lineno for part in item.decorator_list)])
            if (item.name, first) == (code.co_name, code.co_firstlineno):
                return item, ()
    places = [(line, column) for line, _, column, _ in code.co_positions() if line is not None]
    first, last = min(places)[0], max(places)[0]
    around = [s for s in ast.walk(tree) if isinstance(s, ast.stmt) and s.lineno <= first and last <= _end(s)]
    statement = max(around, key=lambda s: (s.lineno, -_end(s)))
    return statement, [(line - statement.lineno, column) for line, column in places]


def _framework_names(tree: ast.AST) -> dict[str, str]:
    """See `syntax.framework_names`: here names stand for what they are bound to now."""
    used, space = {item.id for item in ast.walk(tree) if isinstance(item, ast.Name)}, vars(sys.modules[MAIN])
    found = [(n, v, str(getattr(v, "__name__", ""))) for n, v in space.items() if n in used]
    return {n: x if isinstance(v, types.ModuleType) else f"{getattr(v, '__module__', '')}.{x}" for n, v, x in found}


def _modules_in(tree: ast.AST) -> Iterator[Import]:
    """The modules behind `package.module.name`, where `package` is a module-level name."""
    for item in ast.walk(tree):
        names: list[str] = []
        root = item
        while isinstance(root, ast.Attribute):
            names, root = [root.attr, *names], root.value
        value = vars(sys.modules[MAIN]).get(root.id) if isinstance(root, ast.Name) else None
        for name in names:
            value = getattr(value, name, None) if isinstance(value, types.ModuleType) else None
            if isinstance(value, types.ModuleType):
                yield value.__name__, None


def _tree_with(code: types.CodeType, text: str) -> ast.Module | None:
    """The syntax tree of a text, if `code` was compiled from it."""
    flags = (code.co_flags & _FUTURE) | ast.PyCF_ALLOW_TOP_LEVEL_AWAIT
    try:
        tree = compile(text, code.co_filename, "exec", flags | ast.PyCF_ONLY_AST, dont_inherit=True)
        compiled = compile(tree, code.co_filename, "exec", flags, dont_inherit=True)
    except (SyntaxError, ValueError):
        return None
    return tree if any(other == code for other in _codes(compiled)) else None


def _end(statement: ast.stmt) -> int:
    return statement.end_lineno or statement.lineno


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    for value in code.co_consts:
        if isinstance(value, types.CodeType):
            yield value
            yield from _codes(value)


def _globals_of(code: types.CodeType) -> Iterator[str]:
    for each in (code, *_codes(code)):
        yield from (i.argval for i in dis.get_instructions(each) if i.opname in ("LOAD_GLOBAL", "LOAD_NAME"))


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not set yet
        return None


def _named(module: str, name: str) -> Any:
    """What a loaded module calls so; None for nothing."""
    item: Any = sys.modules.get(module)
    for part in name.split("."):
        item = getattr(item, part, None)
    return item


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    return None if field.default_factory is dataclasses.MISSING else field.default_factory
