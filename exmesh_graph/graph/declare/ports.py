"""What a node type looks like from outside: ports and parameters, read off the function's annotations."""

from __future__ import annotations

import contextlib
import functools
import inspect
import pathlib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from exmesh_graph.errors import StoreError
from exmesh_graph.graph.declare.node import Component, NodeDef, Note
from exmesh_graph.graph.declare.packs import Packs, current
from exmesh_graph.params import Auto, Params, Takes
from exmesh_graph.types import Artifact

B = TypeVar("B")
RESERVED = ("type", "graph", "seed", "doc", "every", "at", "each", "limits", "bypass",
            "repeat", "carry", "next", "nodes")  # fmt: skip
_LISTS = (list, tuple, Sequence)


@dataclass(frozen=True)
class Port:
    """One end of a wire: the nominal types it takes (outputs have one), its facets, whether it may be absent.

    `many`: a list of such values, of a length that is known when it is made. Its elements are called `views[1]`, ...
    """

    name: str
    types: tuple[type, ...]
    facets: Mapping[str, Any] = field(default_factory=dict)
    optional: bool = False
    was: tuple[str, ...] = ()
    many: bool = False

    @property
    def type(self) -> Any:
        """The one type of an output."""
        return self.types[0]

    @property
    def plugged(self) -> bool:
        """Whether it takes components and nothing else."""
        return all(issubclass(kind, Component) for kind in self.types)

    @property
    def mixed(self) -> bool:
        """Whether it takes an artifact or a component: the link says which, by naming an output or not."""
        return not self.plugged and any(issubclass(kind, Component) for kind in self.types)

    @property
    def promises(self) -> dict[str, Any]:
        """What is known of every value of an output before it is made; `facets(x=None)` takes a promise back."""
        known = {**getattr(self.type, "conventions", {}), **self.facets}
        return {name: value for name, value in known.items() if value is not None}

    def wanted(self, kind: Any) -> dict[str, Any]:
        """The facets that an input asks of a value of the type `kind`."""
        base = next((getattr(own, "conventions", {}) for own in self.types if issubclass(kind, own)), {})
        return {name: value for name, value in {**base, **self.facets}.items() if value is not None}

    def clashes(self, source: Port) -> dict[str, tuple[Any, Any]]:
        """Facets that this input asks for and `source` promises otherwise: {name: (wanted, promised)}."""
        promised = source.promises
        wanted = self.wanted(source.type)
        return {k: (v, promised[k]) for k, v in wanted.items() if k in promised and promised[k] != v}

    def takes(self, source: Port) -> bool:
        """Whether the output `source` may be wired to this input, as far as is known before a run."""
        return issubclass(source.type, self.types) and not self.clashes(source)

    def __str__(self) -> str:
        extra = ", ".join(f"{key}={value!r}" for key, value in self.facets.items())
        words = " | ".join(map(type_name, self.types)) + (f"[{extra}]" if extra else "")
        return f"list of {words}" if self.many else words


@dataclass(frozen=True)
class Signature:
    """Ports and parameters of a node type."""

    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]
    params: type[Params]
    params_name: str | None
    doc: str
    component: type[Component] | None = None

    @functools.cached_property
    def renamed(self) -> dict[str, str]:
        """{a name that an input or parameter had before: the one it has now}"""
        ports = {old: name for name, port in self.inputs.items() for old in port.was}
        return ports | {old: name for name in self.params.model_fields for old in self.extra(name).get("was", ())}

    @functools.cached_property
    def renamed_outputs(self) -> dict[str, str]:
        """{a name that an output had before: the one it has now}"""
        return {old: name for name, port in self.outputs.items() for old in port.was}

    def names_of(self, key: str) -> set[str]:
        """All names of the input or parameter that `key` names, present and old."""
        name = self.renamed.get(key, key)
        return {name, *(old for old, new in self.renamed.items() if new == name)}

    @functools.cached_property
    def path_fields(self) -> set[str]:
        """Names of the parameters that hold file paths."""
        return {name for name, info in self.params.model_fields.items() if _holds(info.annotation, pathlib.PurePath)}

    def tuning_fields(self) -> set[str]:
        """Names of the parameters that cannot change the result."""
        return {name for name in self.params.model_fields if self.extra(name).get("tuning")}

    def decided_by(self) -> dict[str, str]:
        """{parameter: port} of those that may be `auto`."""
        return self.noted(Auto)

    def noted(self, kind: type[Auto] | type[Takes]) -> dict[str, str]:
        """{parameter: port} of those that are marked so."""
        fields = self.params.model_fields.items()
        return {name: note.port for name, info in fields for note in info.metadata if isinstance(note, kind)}

    def extra(self, name: str) -> dict[str, Any]:
        """Unit and tuning mark of a parameter."""
        return dict(extra) if isinstance(extra := self.params.model_fields[name].json_schema_extra, dict) else {}


def signature(definition: NodeDef) -> Signature:
    """The signature of a node or component type. Raises TypeError when the declaration cannot be used."""
    own = _signature(definition.function)
    if own.path_fields and definition.sources is None:
        names = ", ".join(sorted(own.path_fields))
        raise TypeError(
            f"node type {definition.type!r} has path parameters ({names}) but declares no sources=: "
            "the contents of the files it reads would not be part of its key"
        )
    return own


def signature_of(packs: Packs, name: Any) -> Signature | None:
    """The signature of the type of this name, present or old; None where there is none that can be used."""
    definition = packs.find(name) if isinstance(name, str) else None
    with contextlib.suppress(TypeError, NameError):
        return None if definition is None else signature(definition)
    return None


def type_name(kind: type) -> str:
    """What messages call a wire type or a component class."""
    return kind.type_name if issubclass(kind, Artifact) else kind.__name__


def base_name(port: str) -> str:
    """The port that `views[2]`, an element of a list, belongs to."""
    return port.partition("[")[0]


def link_form(port: Port) -> str:
    """How a link to this port is written."""
    if port.many:
        return '["@node.port", ...] or "@node.port", a list'
    return '"@component"' if port.plugged else '"@node.port" or "@component"' if port.mixed else '"@node.port"'


def types_by_name() -> dict[str, type]:
    """The wire types and component classes that the current session knows, by the name that messages give them."""
    components = {kind.__name__: kind for kind in reversed(_subclasses(Component))}
    return {**components, Artifact.type_name: Artifact, **artifact_types()}


def artifact_types() -> dict[str, type[Artifact]]:
    """{type name: class} of the imported wire types. A class that was defined again counts as it is now.

    Raises StoreError when two classes have one name; those of packs that only other sessions use do not count.
    """
    known: dict[str, dict[str, type[Artifact]]] = {}
    for kind in _subclasses(Artifact)[1:]:
        if "type_name" in vars(kind):
            known.setdefault(kind.type_name, {})[f"{kind.__module__}.{kind.__qualname__}"] = kind
    for name, kinds in known.items():
        if len(kinds) > 1:
            known[name] = {origin: kind for origin, kind in kinds.items() if not _foreign(kind)}
        if len(known[name]) > 1:
            owners = " and ".join(kind.__module__ for kind in known[name].values())
            raise StoreError(f"two artifact classes are called {name!r}, in {owners}")
    return {name: kind for name, kinds in known.items() for kind in kinds.values()}


def _foreign(kind: type[Artifact]) -> bool:
    """Whether only packs of other sessions know a class."""
    if not current().leaves_out(kind.__module__):
        return False
    signatures = [signature_of(current(), name) for name in current().types]
    ports = [port for s in signatures if s is not None for port in (*s.inputs.values(), *s.outputs.values())]
    return all(kind not in port.types for port in ports)


def _subclasses(base: type[B]) -> list[type[B]]:
    """`base` and all classes below it, bases first, in the order of their definition."""
    return [base, *(inner for kind in base.__subclasses__() for inner in _subclasses(kind))]


@functools.cache
def component_ports(cls: type[Component]) -> Mapping[str, Port]:
    """The fields of a component class that take components."""
    ports = {}
    for name, info in cls.model_fields.items():
        if _holds(info.annotation, Component):
            ports[name] = _port(cls, name, info.annotation, not info.is_required())
            if not ports[name].plugged:
                raise TypeError(f"{cls.__qualname__}: {name} is {ports[name]}; a component holds components only")
            if not info.is_required() and info.get_default(call_default_factory=True) is not None:
                raise TypeError(f"{cls.__qualname__}: {name} may be required or None, but not a component by default")
    return ports


@functools.cache
def _signature(function: Callable[..., Any]) -> Signature:
    if isinstance(function, type) and issubclass(function, Component):
        _refuse_clashes(function, {}, function)
        return Signature(component_ports(function), {}, function, None, inspect.getdoc(function) or "", function)
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
    result = Signature(inputs, outputs, params, params_name, inspect.getdoc(function) or "")
    if taken := {*result.renamed, *result.renamed_outputs} & {*inputs, *outputs, *params.model_fields, *RESERVED}:
        raise TypeError(f"{function.__qualname__}: old names in use: {', '.join(sorted(taken))}")
    for name, port in (*result.noted(Auto).items(), *result.noted(Takes).items()):
        if port not in inputs or not inputs[port].optional:
            raise TypeError(f"{function.__qualname__}: {name} goes by {port}, which is no optional input")
    return result


def _outputs(function: Callable[..., Any], returned: Any) -> dict[str, Port]:
    if not (_is_subclass(returned, tuple) and hasattr(returned, "_fields")):
        raise TypeError(f"{function.__qualname__} must return a NamedTuple of its output ports")
    hints = typing.get_type_hints(returned, include_extras=True)
    ports = {name: _port(function, name, hints[name], False) for name in returned._fields}
    for port in ports.values():
        if len(port.types) > 1 or port.plugged or (port.many and port.optional):
            raise TypeError(f"{function.__qualname__}: output {port.name} must be one Artifact type, not {port}")
    return ports


def _port(owner: Callable[..., Any], name: str, hint: Any, optional: bool) -> Port:
    """A port from `T`, `A | B`, `T | None`, `list[T]` and `Annotated[..., facets(...)]` around any of them.

    `Artifact | Component` makes a mixed port: one solver takes a finished artifact or the spec of how to do without.
    """
    notes: list[Note] = []
    kinds: tuple[Any, ...] = (hint,)
    composed = (typing.Annotated, typing.Union, types.UnionType, *_LISTS)
    many = False
    while len(kinds) == 1 and (origin := typing.get_origin(kinds[0])) in composed:
        args = typing.get_args(kinds[0])
        many = many or origin in _LISTS
        args = tuple(arg for arg in args if arg is not Ellipsis)
        if origin is typing.Annotated:
            notes += [note for note in args[1:] if isinstance(note, Note)]
            args = args[:1]
        kinds = tuple(arg for arg in args if arg is not type(None))
        optional = optional or len(kinds) < len(args)
    facets = {name: value for note in notes for name, value in note.facets.items()}
    old = tuple(name for note in notes for name in note.was)
    if all(_is_subclass(kind, Artifact) or _is_subclass(kind, Component) for kind in kinds):
        port = Port(name, kinds, facets, optional, old, many)
        if many and (port.plugged or port.mixed):
            raise TypeError(f"{owner.__qualname__}: port {name} is a list of components; lists hold artifacts")
        return port
    shown = " | ".join(map(str, kinds))
    raise TypeError(f"{owner.__qualname__}: port {name} is {shown}, not an Artifact type or Component class")


def _refuse_clashes(function: Callable[..., Any], inputs: Mapping[str, Port], params: type[Params]) -> None:
    both = set(inputs) & set(params.model_fields)
    reserved = (set(inputs) | set(params.model_fields)) & set(RESERVED)
    if both or reserved:
        raise TypeError(f"{function.__qualname__}: names in use already: {sorted(both | reserved)}")


def _is_subclass(value: Any, base: type) -> bool:
    return isinstance(value, type) and issubclass(value, base)


def _holds(annotation: Any, base: type) -> bool:
    """Whether a (possibly nested) annotation mentions a subclass of `base`."""
    return _is_subclass(annotation, base) or any(_holds(arg, base) for arg in typing.get_args(annotation))
