"""Which nodes of a graph run: all that something needs, what named ones need, or one and all below it again."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from exmesh_graph.api.arguments import node_names
from exmesh_graph.api.values import here
from exmesh_graph.errors import GraphError
from exmesh_graph.graph.problems import nearest, without_rounds

if TYPE_CHECKING:
    from exmesh_graph.api.opening import Names
    from exmesh_graph.graph.language.check import Checked


class Selection(NamedTuple):
    """A graph, the nodes of it that run (None: all), and those that run even on a hit."""

    graph: Checked
    targets: set[str] | None
    force: set[str]


def selected(checked: Checked, nodes: Names = None, force: Names = None, start: Names = None) -> Selection:
    """What runs of a graph: what `nodes` need (none: whatever something needs), `force` and `start` in any case.

    `start` means a node and all nodes below it. Names may be patterns (see `matching`); nodes that nothing needs run
    where they are named. Raises GraphError for a name that fits nothing.
    """
    whole = checked.with_idle()
    again = {*matching(whole, start)}
    for name, bound in whole.nodes.items() if again else ():
        again |= {name} if any(link.node in again for link in bound.inputs.values()) else set()
    forced, ends = {*matching(whole, force)}, matching(whole, nodes)
    if not ends:
        extra = forced | {*matching(whole, start)}
        if extra <= checked.nodes.keys():
            return Selection(checked, None, forced | (again & checked.nodes.keys()))
        ends = [*checked.nodes, *extra]
    targets = whole.needed_for(ends)
    return Selection(whole, targets, (forced | again) & targets)


def matching(checked: Checked, names: Names) -> list[str]:
    """The nodes that names mean: `*` stands for anything, a name without rounds for all rounds of a node, and the name
    of a repeat or a subgraph for all nodes in it.

    Raises GraphError with the nearest names where a graph has none.
    """
    found: dict[str, None] = {}
    plain: dict[str, list[str]] = {}
    for name in checked.nodes:
        for known in dict.fromkeys((without_rounds(name), *_around(name))):
            plain.setdefault(known, []).append(name)
    for given in node_names(names):
        if given in checked.nodes:
            found[given] = None
            continue
        if given.endswith("]") and (home := given.rpartition("[")[0]) in checked.nodes and checked.nodes[home].each:
            found[home] = None  # one of the nodes that it stands for
            continue
        fits = [name for key in _fitting(given, plain) for name in plain[key]] or _fitting(given, checked.nodes)
        if not fits:
            _refuse(checked, given, plain)
        found.update(dict.fromkeys(fits))
    return list(found)


def _around(name: str) -> Iterator[str]:
    """What a node lies in: `a`, `a[2]`, `a.b`, `a[2].b` for `a[2].b.node`."""
    while "." in name:
        name = name.rpartition(".")[0]
        yield from (name, without_rounds(name))


def _fitting(pattern: str, names: Iterable[str]) -> list[str]:
    form = re.compile(".*".join(re.escape(part) for part in pattern.split("*")))
    return [name for name in names if form.fullmatch(name)]


def _refuse(checked: Checked, name: str, plain: Mapping[str, list[str]]) -> None:
    if name in checked.components:
        users = [node for node, bound in checked.nodes.items() if any(c.name == name for c in bound.plugged())]
        what = f"{name} is a component, which never runs by itself"
        raise GraphError(what, where=str(here()), fix=f"name a node that uses it: {', '.join(users[:8])}")
    close = nearest(name, [*checked.nodes, *plain]) or list(checked.nodes)
    raise GraphError(f"the graph has no node {name!r}", where=str(here()), expected=", ".join(close[:8]))
