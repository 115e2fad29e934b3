"""Graphs merged into one in which equal nodes stand once.

Nodes are equal when type, version, parameters, seed, source files and, recursively, inputs are: then their keys are
equal whatever their code and their files hold, and in a graph merged out of many one execution serves them all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from exmesh_graph.graph.cache.keys import key_of, preimage_of
from exmesh_graph.graph.declare.components import BoundComponent
from exmesh_graph.graph.language.check import Bound, Checked
from exmesh_graph.graph.language.links import Link


@dataclass(frozen=True)
class Member:
    """One graph inside a merged one: `names` maps its node names to those of the merged graph."""

    label: str
    names: Mapping[str, str]


@dataclass(frozen=True)
class Merged:
    """One graph that holds all members, in an order in which it can run. It publishes nothing."""

    checked: Checked
    members: tuple[Member, ...]


def merge(graphs: Iterable[tuple[str, Checked]], name: str = "") -> Merged:
    """One graph out of (label, graph) pairs. A node keeps its name from the first graph; others are `label:name`."""
    pairs = list(graphs)
    if not pairs:
        raise ValueError("nothing to merge")
    nodes: dict[str, Bound] = {}
    known: dict[str, str] = {}
    members = []
    components: dict[str, BoundComponent] = {}
    for index, (label, graph) in enumerate(pairs):
        ids = identities(graph)
        names: dict[str, str] = {}
        for own, bound in graph.nodes.items():
            if ids[own] not in known:
                known[ids[own]] = new = own if index == 0 else f"{label}:{own}"
                inputs = {port: Link(names[link.node], link.port) for port, link in bound.inputs.items()}
                nodes[new] = replace(bound, name=new, inputs=inputs)
            names[own] = known[ids[own]]
        members.append(Member(label, names))
        components.update({n if index == 0 else f"{label}:{n}": plug for n, plug in graph.components.items()})
    first = pairs[0][1]
    whole = Checked(name or first.name, first.file, nodes, {}, first.params, components=components, packs=first.packs)
    return Merged(whole, tuple(members))


def identities(graph: Checked) -> dict[str, str]:
    """For every node a digest of all that its key depends on, as far as it is known before anything runs."""
    known: dict[str, str] = {}
    for name, bound in graph.nodes.items():
        sources = {source: str(path) for source, path in bound.sources.items()}
        inputs = {port: (link.port, known[link.node]) for port, link in bound.inputs.items()}
        known[name] = key_of(preimage_of(bound, "", sources, inputs))
    return known
