"""Node types as data: ports, parameters, what a node takes. For `exmesh nodes`, its pages and its JSON."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from exmesh_graph.api.opening import packs
from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.ports import Port, Signature, link_form, signature
from exmesh_graph.graph.problems import nearest
from exmesh_graph.params import Takes

SCHEMA = "exmesh.nodes.v1"
_LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "multiple_of": "multiple of",
           "min_length": "min_length", "max_length": "max_length"}  # fmt: skip


@dataclass(frozen=True)
class PortInfo:
    """An input or output: `type` with its facets, how a link to it is written, whether it may be left out."""

    name: str
    type: str
    link: str
    optional: bool


@dataclass(frozen=True)
class ParameterInfo:
    """A parameter: `default` as text, None where it must be given; `tuning` ones stay out of the key."""

    name: str
    type: str
    default: str | None
    limits: tuple[str, ...]
    unit: str
    doc: str
    tuning: bool


@dataclass(frozen=True)
class TypeInfo:
    """A node type, or a component type, which has no outputs; `family` is what the module says of all its types."""

    type: str
    component: bool
    version: str
    doc: str
    traits: tuple[str, ...]
    libraries: tuple[str, ...]
    inputs: tuple[PortInfo, ...]
    outputs: tuple[PortInfo, ...]
    parameters: tuple[ParameterInfo, ...]
    family: str = ""

    @property
    def title(self) -> str:
        """The first line of its documentation."""
        return self.doc.partition("\n")[0]


def node_types() -> dict[str, TypeInfo]:
    """All node and component types at hand, by name; `broken` tells of those that are declared wrongly."""
    return {name: _described(definition) for name, definition in packs().types.items() if not _fault(definition)}


def broken() -> dict[str, str]:
    """{module or type: why it cannot be used}"""
    known = packs()
    wrong = {name: fault for name, definition in known.types.items() if (fault := _fault(definition))}
    return {module: f"cannot be imported: {why}" for module, why in known.broken.items()} | wrong


def schema_text() -> str:
    """The JSON schema of graph files with the node types at hand, for editors."""
    from exmesh_graph.api.schema import schema_text as text_of

    return text_of(packs())


def describe(type: str) -> TypeInfo:
    """One type, also by a name that it had before. Raises ExmeshError with the nearest names."""
    known = packs()
    definition = known.find(type)
    if definition is None:
        broken = "".join(f"\n  cannot import {module}: {why}" for module, why in known.broken.items())
        near = ", ".join(nearest(type, known.types))
        raise ExmeshError(f"there is no node type {type!r}{broken}", expected=near, fix="exmesh nodes lists all")
    if fault := _fault(definition):
        raise ExmeshError(f"{definition.type} {fault}", where=definition.origin)
    return _described(definition)


def as_json(types: Iterable[TypeInfo]) -> dict[str, Any]:
    """What `exmesh nodes --json` writes."""
    return {"schema": SCHEMA, "types": [asdict(info) for info in types], "broken": broken()}


def _fault(definition: NodeDef) -> str:
    """Why a declaration cannot be used."""
    try:
        signature(definition)
    except (TypeError, NameError) as error:
        return f"is declared wrongly: {error}"
    return ""


def _described(definition: NodeDef) -> TypeInfo:
    known = signature(definition)
    traits = [] if definition.deterministic else ["not deterministic"]
    traits += ["resumable"] if definition.resumable else []
    traits += [f"takes {name} {n:g}" for name, n in definition.resources.items() if (name, n) != ("cpu", 1)]
    names = [name for name in known.params.model_fields if name not in known.inputs]
    return TypeInfo(
        definition.type,
        known.component is not None,
        definition.version,
        known.doc,
        tuple(traits),
        tuple(definition.libraries),
        tuple(map(_port, known.inputs.values())),
        tuple(map(_port, known.outputs.values())),
        tuple(_parameter(known, name) for name in names),
        inspect.getdoc(sys.modules[definition.function.__module__]) or "",
    )


def _port(port: Port) -> PortInfo:
    return PortInfo(port.name, str(port), link_form(port), port.optional)


def _parameter(known: Signature, name: str) -> ParameterInfo:
    info = known.params.model_fields[name]
    kind = getattr(info.annotation, "__name__", "") if isinstance(info.annotation, type) else str(info.annotation)
    limits = [
        f"{sign} {getattr(limit, word)}"
        for limit in info.metadata
        for word, sign in _LIMITS.items()
        if getattr(limit, word, None) is not None
    ]
    if name in known.decided_by():
        limits.append(f"or auto, by {known.decided_by()[name]}")
    if taken := known.noted(Takes).get(name):
        limits.append(f"takes {taken}")
    default = None if info.is_required() else repr(info.get_default(call_default_factory=True))
    extra = known.extra(name)
    return ParameterInfo(
        name,
        kind.replace("typing.", "").replace("pathlib.", ""),
        default,
        tuple(limits),
        str(extra.get("unit") or ""),
        info.description or "",
        bool(extra.get("tuning")),
    )
