"""Node and component types as the page's catalog shows them: ports with their wire types, parameters with ranges."""

from __future__ import annotations

import pathlib
import typing
from collections.abc import Iterable, Mapping
from typing import Any

from exmesh_graph.graph.declare.node import Component, NodeDef
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, signature_of, type_name, types_by_name
from exmesh_graph.params import Auto, Params
from exmesh_graph.studio.values import plain
from exmesh_graph.types import Artifact

_LIMITS = ("ge", "gt", "le", "lt", "multiple_of")
_EDITORS: tuple[tuple[type, str], ...] = (
    (bool, "bool"), (int, "int"), (float, "float"), (pathlib.PurePath, "path"), (str, "str"),
    (list, "list"), (tuple, "list"), (dict, "map"),
)  # fmt: skip


class TypeFacts:
    """The types of a session as data, each described once."""

    def __init__(self, packs: Packs) -> None:
        self.packs = packs
        self._known: dict[str, tuple[NodeDef, dict[str, Any]]] = {}

    def of(self, name: str) -> dict[str, Any] | None:
        """One type; None where there is none that can be used."""
        definition, kind = self.packs.find(name), signature_of(self.packs, name)
        if definition is None or kind is None:
            return None
        known = self._known.get(definition.type)
        if known is None or known[0] is not definition:
            known = self._known[definition.type] = definition, _described(definition, kind)
        return known[1]

    def all(self) -> dict[str, Any]:
        """What `GET /api/catalog` answers."""
        found = (self.of(name) for name in self.packs.types)
        return {
            "types": [facts for facts in found if facts is not None],
            "broken": dict(self.packs.broken),
            "wire_types": {name: _bases(kind) for name, kind in types_by_name().items()},
        }

    def used(self, names: Iterable[str]) -> dict[str, Any]:
        """The types of a graph's nodes, without their long documentation, which the catalog has."""
        found = {name: self.of(name) for name in dict.fromkeys(names)}
        left = {"doc": "", "libraries": []}
        return {name: {**facts, **left} for name, facts in found.items() if facts is not None}

    def search(self, words: str, limit: int) -> list[str]:
        """The types that fit all words best first: by their names, then titles, ports and documentation."""
        wanted = words.lower().split()
        ranked = []
        for name in self.packs.types:
            facts = self.of(name)
            if facts is not None:
                ranks = [_rank(word, facts) for word in wanted]
                if None not in ranks:
                    ranked.append((sum(rank for rank in ranks if rank is not None), name))
        return [name for _, name in sorted(ranked)[:limit]]


def port_facts(port: Port) -> dict[str, Any]:
    """PORT of the contract."""
    return {
        "port": port.name, "types": [type_name(kind) for kind in port.types], "label": str(port),
        "optional": port.optional, "component": port.plugged, "mixed": port.mixed, "facets": plain(port.facets),
    }  # fmt: skip


def traits_of(definition: NodeDef) -> list[str]:
    """What a user should know of how a type runs."""
    told = [] if definition.deterministic else ["not deterministic"]
    told += ["resumable"] if definition.resumable else []
    return told + [f"takes {name} {n:g}" for name, n in definition.resources.items() if (name, n) != ("cpu", 1)]


def _described(definition: NodeDef, kind: Signature) -> dict[str, Any]:
    names = [name for name in kind.params.model_fields if name not in kind.inputs]
    outputs = [port_facts(port) for port in kind.outputs.values()]
    if kind.component is not None:
        plugs = [base.__name__ for base in kind.component.__mro__ if _is_plug(base)]
        outputs = [{"port": "", "types": plugs, "label": plugs[-1] if plugs else "component", "optional": False,
                    "component": True, "mixed": False, "facets": {}}]  # fmt: skip
    return {
        "type": definition.type,
        "family": definition.type.partition(".")[0],
        "kind": "node" if kind.component is None else "component",
        "doc": kind.doc,
        "title": kind.doc.partition("\n")[0],
        "version": definition.version,
        "traits": traits_of(definition),
        "libraries": list(definition.libraries),
        "inputs": [port_facts(port) for port in kind.inputs.values()],
        "outputs": outputs,
        "parameters": [parameter_facts(kind, name) for name in names],
    }


def parameter_facts(kind: Signature, name: str) -> dict[str, Any]:
    """PARAMETER of the contract, without what a graph says of it."""
    info = kind.params.model_fields[name]
    annotation: Any = info.annotation
    for note in info.metadata:
        annotation = typing.Annotated[annotation, note]
    leaves = list(_leaves(annotation))
    kinds = [leaf for leaf in leaves if isinstance(leaf, type) and leaf is not type(None)]
    editors = list(dict.fromkeys(word for leaf in kinds for base, word in _EDITORS if issubclass(leaf, base)))
    editors = editors[:1] if set(editors[:2]) == {"bool", "int"} else editors
    choices = [plain(value) for leaf in leaves if isinstance(leaf, tuple) for value in leaf]
    limits: dict[str, Any] = {
        word: next((getattr(note, word) for note in _notes(annotation) if getattr(note, word, None) is not None), None)
        for word in _LIMITS
    }
    extra = kind.extra(name)
    editor = _of_choices(choices) if choices else "number" if editors == ["int", "float"] else "".join(editors[:1])
    return {
        "name": name,
        "type": editor or "any",
        "default": None if info.is_required() else plain(info.get_default(call_default_factory=True)),
        "required": info.is_required(),
        "unit": str(extra.get("unit") or ""),
        "doc": info.description or "",
        **limits,
        "choices": choices or None,
        "optional": type(None) in leaves,
        "tuning": bool(extra.get("tuning")),
        "auto": next((note.port for note in _notes(annotation) if isinstance(note, Auto)), ""),
        "path": name in kind.path_fields,
    }


def _leaves(annotation: Any) -> Iterable[Any]:
    """The plain types of an annotation; what a Literal allows as a tuple."""
    origin, given = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        yield given
    elif origin is typing.Annotated:
        yield from _leaves(given[0])
    elif origin in (list, tuple, dict, set, frozenset):
        yield origin
    elif given:
        for inner in given:
            yield from _leaves(inner)
    else:
        yield annotation


def _notes(annotation: Any) -> Iterable[Any]:
    """All that stands beside the types of an annotation."""
    if typing.get_origin(annotation) is typing.Annotated:
        for note in typing.get_args(annotation)[1:]:
            yield from (note, *getattr(note, "metadata", ()))  # a Field holds its limits in a list
    for inner in typing.get_args(annotation):
        if typing.get_origin(annotation) is not typing.Literal:
            yield from _notes(inner)


def _of_choices(choices: list[Any]) -> str:
    kinds: Mapping[type, str] = {bool: "bool", int: "int", float: "float", str: "str"}
    names = {kinds.get(type(choice), "any") for choice in choices}
    return names.pop() if len(names) == 1 else "any"


def _is_plug(base: type) -> bool:
    return issubclass(base, Component) and base not in (Component, Params)


def _bases(kind: type) -> list[str]:
    known = [base for base in kind.__mro__[1:] if issubclass(base, Artifact | Component)]
    return list(dict.fromkeys(type_name(base) for base in known if base not in (Component, Artifact)))


def _rank(word: str, facts: Mapping[str, Any]) -> int | None:
    """How far from the name a word is found; None where it is nowhere."""
    name = facts["type"].lower()
    ports = " ".join(str(port["label"]) for port in (*facts["inputs"], *facts["outputs"])).lower()
    places = (name.rpartition(".")[2].startswith(word), word in name, word in facts["title"].lower(),
              word in ports, word in facts["doc"].lower(),
              any(word in str(one["name"]).lower() for one in facts["parameters"]))  # fmt: skip
    return next((rank for rank, found in enumerate(places) if found), None)
