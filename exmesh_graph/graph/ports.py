"""What a node type looks like from outside: ports and parameters, read off the function's annotations."""

from __future__ import annotations

import functools
import inspect
import pathlib
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from exmesh_graph.graph.node import Facets, NodeDef, Params
from exmesh_graph.types import Artifact

RESERVED = ("type", "seed", "every", "at", "repeat", "carry", "next", "nodes")


@dataclass(frozen=True)
class Port:
    """One end of a wire: the nominal type it carries, its facets, and whether it may be absent."""

    name: str
    type: type[Artifact]
    facets: Mapping[str, Any] = field(default_factory=dict)
    optional: bool = False

    def __str__(self) -> str:
        extra = ", ".join(f"{key}={value!r}" for key, value in self.facets.items())
        return self.type.type_name + (f"[{extra}]" if extra else "")


@dataclass(frozen=True)
class Signature:
    """Ports and parameters of a node type."""

    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]
    params: type[Params]
    params_name: str | None
    doc: str

    def path_fields(self) -> set[str]:
        """Names of the parameters that hold file paths."""
        return {name for name, info in self.params.model_fields.items() if _holds_path(info.annotation)}

    def tuning_fields(self) -> set[str]:
        """Names of the parameters that cannot change the result."""
        return {name for name in self.params.model_fields if self.extra(name).get("tuning")}

    def extra(self, name: str) -> dict[str, Any]:
        """Unit and tuning mark of a parameter."""
        extra = self.params.model_fields[name].json_schema_extra
        return dict(extra) if isinstance(extra, dict) else {}


def signature(definition: NodeDef) -> Signature:
    """The signature of a node type. Raises TypeError when the declaration cannot be used."""
    found = _signature(definition.function)
    if found.path_fields() and definition.sources is None:
        names = ", ".join(sorted(found.path_fields()))
        raise TypeError(
            f"node type {definition.type!r} has path parameters ({names}) but declares no sources=: "
            "the contents of the files it reads would not be part of its key"
        )
    return found


@functools.cache
def _signature(function: Callable[..., Any]) -> Signature:
    hints = typing.get_type_hints(function, include_extras=True)
    inputs: dict[str, Port] = {}
    params: type[Params] = Params
    params_name = None
    for index, (name, parameter) in enumerate(inspect.signature(function).parameters.items()):
        if index == 0:
            continue
        if name not in hints:
            raise TypeError(f"{function.__qualname__}: {name} has no annotation")
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            if params_name is not None or not _is_subclass(hints[name], Params):
                raise TypeError(f"{function.__qualname__}: the one keyword-only argument is a Params class")
            params, params_name = hints[name], name
        else:
            optional = parameter.default is not inspect.Parameter.empty
            inputs[name] = _port(function, name, hints[name], optional)
    outputs = _outputs(function, hints.get("return"))
    _refuse_clashes(function, inputs, params)
    return Signature(inputs, outputs, params, params_name, inspect.getdoc(function) or "")


def _outputs(function: Callable[..., Any], returned: Any) -> dict[str, Port]:
    if not (_is_subclass(returned, tuple) and hasattr(returned, "_fields")):
        raise TypeError(f"{function.__qualname__} must return a NamedTuple of its output ports")
    hints = typing.get_type_hints(returned, include_extras=True)
    return {name: _port(function, name, hints[name], False) for name in returned._fields}


def _port(function: Callable[..., Any], name: str, hint: Any, optional: bool) -> Port:
    found: dict[str, Any] = {}
    while True:
        origin = typing.get_origin(hint)
        if origin is typing.Annotated:
            hint, *notes = typing.get_args(hint)
            for note in notes:
                if isinstance(note, Facets):
                    found.update(note.values)
        elif origin in (typing.Union, types.UnionType):
            inner = [arg for arg in typing.get_args(hint) if arg is not type(None)]
            if len(inner) != 1:
                raise TypeError(f"{function.__qualname__}: port {name} must have one type")
            optional, hint = True, inner[0]
        else:
            break
    if not _is_subclass(hint, Artifact):
        raise TypeError(f"{function.__qualname__}: port {name} is {hint!r}, not an Artifact type")
    return Port(name, hint, found, optional)


def _refuse_clashes(function: Callable[..., Any], inputs: Mapping[str, Port], params: type[Params]) -> None:
    both = set(inputs) & set(params.model_fields)
    reserved = (set(inputs) | set(params.model_fields)) & set(RESERVED)
    if both or reserved:
        raise TypeError(f"{function.__qualname__}: names in use already: {sorted(both | reserved)}")


def _is_subclass(value: Any, base: type) -> bool:
    return isinstance(value, type) and issubclass(value, base)


def _holds_path(annotation: Any) -> bool:
    if _is_subclass(annotation, pathlib.PurePath):
        return True
    return any(_holds_path(arg) for arg in typing.get_args(annotation))
