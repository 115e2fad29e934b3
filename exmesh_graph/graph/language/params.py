"""Typed parameters of a graph: `faces: 20000`, or `faces: {type: int, default: 20000, ge: 4, unit: ..., doc: ...}`.

A plain value says by itself what may replace it: a number a number, true or false one of these, a list a list, a
mapping a mapping; text and null say nothing. A file that extends another keeps the declarations of its base.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import Problems, Where, closest, nearest

KINDS: dict[str, Any] = {
    "int": int, "float": int | float, "number": int | float, "bool": bool, "str": str, "path": str, "list": list,
    "map": dict, "any": object,
}  # fmt: skip
NUMBERS = ("int", "float", "number")
SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
KEYS = ("type", "default", *SIGNS, "choices", "unit", "doc")


@dataclass(frozen=True)
class Declared:
    """What is known of a graph parameter; `default` stands at `where`, or there is none (`required`)."""

    name: str
    kind: str
    where: Where
    default: Any = None
    required: bool = False
    limits: Mapping[str, float] = field(default_factory=dict)
    choices: tuple[Any, ...] = ()
    unit: str = ""
    doc: str = ""
    inferred: bool = False
    declared_at: Where | None = None

    def __str__(self) -> str:
        words = [self.kind, *(f"{SIGNS[sign]} {limit:g}" for sign, limit in self.limits.items())]
        words += ["one of " + ", ".join(map(str, self.choices))] if self.choices else []
        return ", ".join(words) + (f" [{self.unit}]" if self.unit else "") + (f": {self.doc}" if self.doc else "")

    def judge(self, value: Any, where: Where, problems: Problems) -> Any:
        """The value, a whole number for an int written as 2e4; notes what does not fit."""
        if self.kind == "int" and isinstance(value, float) and value.is_integer():
            value = int(value)
        if _is_kind(value, self.kind) and all(
            getattr(operator, sign)(value, limit) for sign, limit in self.limits.items()
        ):
            if not self.choices or value in self.choices:
                return value
        elif self.inferred and value is None:
            return value
        place = "" if self.declared_at is None else f" (declared at {self.declared_at})"
        fix = f"its default is {self.default!r}; write {{type: any, default: ...}} if more makes sense"
        problems.add(
            "param", where, f"the graph parameter {self.name} cannot be {value!r}", expected=f"{self}{place}",
            nearest=nearest(str(value), map(str, self.choices)), fix=fix if self.inferred else "",
        )  # fmt: skip
        return value if isinstance(self.default, str) else self.default


def declare(params: Map, problems: Problems) -> dict[str, Declared]:
    """What the values under `params:` say of themselves."""
    declared = {}
    for name, value in params.items():
        where = params.lines[name]
        if is_declaration(value):
            declared[str(name)] = _long_form(str(name), value, problems)
        else:
            kinds = {bool: "bool", int: "number", float: "number", list: "list", Map: "map"}
            declared[str(name)] = Declared(str(name), kinds.get(type(value), "any"), where, value, inferred=True)
    return declared


def is_declaration(value: Any) -> bool:
    """Whether a parameter stands there in its long form."""
    return isinstance(value, Map) and ("type" in value or "default" in value)


def give(params: Map, name: str, value: Any, where: Where) -> None:
    """Set a parameter in a mapping of parameters; its declaration stays, unless the value is a new one."""
    old = params.get(name)
    if is_declaration(old) and not is_declaration(value):
        declaration = old.copy()  # type: ignore[union-attr]
        declaration.put("default", value, where)
        value = declaration
    params.put(name, value, where)


def _long_form(name: str, raw: Map, problems: Problems) -> Declared:
    def refuse(key: Any, what: str, **more: Any) -> None:
        problems.add("param", raw.lines[key], f"the graph parameter {name}: {what}", **more)

    kind = raw.get("type", "any")
    if kind not in KINDS:
        refuse("type", f"there is no type {kind!r}", nearest=closest(kind, KINDS))
        kind = "any"
    limits = {}
    for key, value in raw.items():
        if key in SIGNS and kind in NUMBERS and _is_kind(value, "float"):
            limits[key] = value
        elif key in SIGNS:
            refuse(key, f"{key} takes a number, and stands with the types int and float", found=repr(value))
        elif key == "choices" and not (isinstance(value, list) and value):
            refuse(key, "choices is a list of values", found=repr(value))
        elif key not in KEYS:
            refuse(key, f"a parameter has no key {key!r}", nearest=closest(key, KEYS))
    choices = raw.get("choices")
    where = raw.lines.get("default", raw.where)
    return Declared(
        name, kind, where, raw.get("default"), "default" not in raw, limits,
        tuple(choices) if isinstance(choices, list) else (), str(raw.get("unit", "")), str(raw.get("doc", "")),
        declared_at=raw.where,
    )  # fmt: skip


def _is_kind(value: Any, kind: str) -> bool:
    number = kind in NUMBERS
    fits = isinstance(value, KINDS[kind]) and not (number and isinstance(value, bool))
    return fits and (not number or math.isfinite(value))
