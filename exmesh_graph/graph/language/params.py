"""Typed parameters of a graph: `faces: 20000`, or `faces: {type: int, default: 20000, ge: 4, unit: ..., doc: ...}`.

A plain value says by itself what may replace it: a number a number, true or false one of these, a list a list, a
mapping a mapping; text and null say nothing. A file that extends another keeps the declarations of its base.

A choice may give other parameters defaults of their own: `size: {default: large, choices: {large: {}, small: {faces:
500}}}`. What a nearer file, a variant or `--set` says of `faces` itself counts more (`forget`, `spec.resolve_params`).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Collection, Iterator, Mapping
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
KEYS = ("type", "default", *SIGNS, "choices", "env", "unit", "doc")
ENV = "EXMESH_PARAM_"  # of other variables a graph file, which may be a stranger's, is told nothing


@dataclass(frozen=True)
class Declared:
    """What is known of a graph parameter; `default` stands at `where`, or there is none (`required`).

    env       an environment variable that counts more than the default and choices, less than --set
    choices   what it may be; where they are a mapping, {value: {other parameter: its default with this value}}
    """

    name: str
    kind: str
    where: Where
    default: Any = None
    required: bool = False
    limits: Mapping[str, float] = field(default_factory=dict)
    choices: Collection[Any] = ()
    unit: str = ""
    doc: str = ""
    env: str = ""
    inferred: bool = False
    declared_at: Where | None = None

    def __str__(self) -> str:
        words = [self.kind, *(f"{SIGNS[sign]} {limit:g}" for sign, limit in self.limits.items())]
        words += ["one of " + ", ".join(map(str, self.choices))] if self.choices else []
        return ", ".join(words) + (f" [{self.unit}]" if self.unit else "") + (f": {self.doc}" if self.doc else "")

    def settings(self) -> Iterator[tuple[Any, str, Any, Where]]:
        """(choice, parameter that it sets, value, place) of all choices."""
        for choice, settings in self.choices.items() if isinstance(self.choices, Map) else ():
            for name, value in settings.items() if isinstance(settings, Map) else ():
                yield choice, name, value, settings.lines[name]

    def judge(self, value: Any, where: Where, problems: Problems) -> Any:
        """The value, a whole number for an int written as 2e4; notes what does not fit."""
        if self.kind == "int" and isinstance(value, float) and value.is_integer():
            value = int(value)
        fits = _is_kind(value, self.kind) and all(
            getattr(operator, s)(value, limit) for s, limit in self.limits.items()
        )
        if (fits and (not self.choices or value in [*self.choices])) or (self.inferred and value is None):
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
        if is_declaration(value):
            declared[str(name)] = _long_form(str(name), value, problems)
        else:
            kinds = {bool: "bool", int: "number", float: "number", list: "list", Map: "map"}
            declared[str(name)] = Declared(
                str(name), kinds.get(type(value), "any"), params.lines[name], value, inferred=True
            )
    return declared


def is_declaration(value: Any) -> bool:
    """Whether a parameter stands there in its long form."""
    return isinstance(value, Map) and not value.keys().isdisjoint(("type", "default", "choices"))


def forget(params: Map, said: Mapping[str, Any]) -> None:
    """Take what `said`, which is nearer, says the value of out of what the choices of `params` set."""
    names = [name for name, value in said.items() if not is_declaration(value) or "default" in value]
    for param in params.values():
        choices = param.get("choices") if is_declaration(param) else None
        for settings in choices.values() if isinstance(choices, Map) else ():
            for name in names if isinstance(settings, Map) else ():
                settings.pop(name, None)


def given(old: Any, value: Any, where: Where) -> Any:
    """What stands for a parameter that was `old` and is set: its declaration stays, unless the value is a new one."""
    if not is_declaration(old) or is_declaration(value):
        return value
    declaration: Map = old.copy()
    declaration.put("default", value, where)
    return declaration


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
        elif key == "choices" and not (value and isinstance(value, list | Map)):
            refuse(key, "choices is a list of values, or maps them to what they set", found=repr(value))
        elif key == "choices" and isinstance(value, Map):
            if wrong := [choice for choice, settings in value.items() if not isinstance(settings, Map)]:
                refuse(key, f"the choice {wrong[0]} is no mapping of parameters", expected="{small: {faces: 500}, ...}")
        elif key == "env" and not str(value).startswith(ENV):
            refuse(key, f"{value!r} is not a variable that a graph may ask for", expected=f"{ENV}NAME")
        elif key not in KEYS:
            refuse(key, f"a parameter has no key {key!r}", nearest=closest(key, KEYS))
    choices = raw.get("choices")
    where = raw.lines.get("default", raw.where)
    return Declared(
        name, kind, where, raw.get("default"), "default" not in raw, limits,
        choices if isinstance(choices, list | Map) else (), str(raw.get("unit", "")), str(raw.get("doc", "")),
        str(raw.get("env", "")),
        declared_at=raw.where,
    )  # fmt: skip


def _is_kind(value: Any, kind: str) -> bool:
    number = kind in NUMBERS
    fits = isinstance(value, KINDS[kind]) and not (number and isinstance(value, bool))
    return fits and (not number or math.isfinite(value))
