"""What stands in a graph file before it is unrolled: blocks, sub-graphs, links, settings of single rounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NoReturn

from exmesh_graph.graph.language.yamlfile import Map
from exmesh_graph.graph.problems import GraphErrors, Problem, Where


def refuse(where: Where, what: str, *, near: Iterable[str] = (), **more: Any) -> NoReturn:
    """A patch whose precondition does not hold; `more` are Problem's expected, found and fix."""
    raise GraphErrors([Problem("patch", where, what, nearest=tuple(near), **more)])


def clone(value: Any) -> Any:
    """A deep copy of plain values, places kept."""
    if isinstance(value, Map):
        other = Map(value.where)
        for key, item in value.items():
            other.put(key, clone(item), value.lines[key])
        return other
    return [clone(item) for item in value] if isinstance(value, list) else value


def is_block(entry: Any) -> bool:
    """Whether an entry is a repeat block with nodes."""
    return isinstance(entry, Map) and "repeat" in entry and isinstance(entry.get("nodes"), Map)


def is_part(entry: Any) -> bool:
    """Whether an entry uses a graph file as a sub-graph."""
    return isinstance(entry, Map) and "graph" in entry


def is_link(value: Any) -> bool:
    """Whether a value is a link (`@@` begins a plain string)."""
    return isinstance(value, str) and value.startswith("@") and not value.startswith("@@")


def layers_of(entry: Map) -> Iterator[tuple[Map, str, Any]]:
    """(settings, `every` or `at`, number) of single rounds of a node."""
    for key in ("every", "at"):
        rounds = entry.get(key)
        for number, layer in rounds.items() if isinstance(rounds, Map) else ():
            if isinstance(layer, Map):
                yield layer, key, number
