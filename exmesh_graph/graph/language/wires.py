"""Judging the wires of an expanded graph: does the far end exist, is its type taken, do the facets agree; cycles.

Facets that an output does not promise are left to the run (see `execute`). Old names of types and outputs, which
`@node(..., was=("old.type",))` and `Annotated[Mesh, was("old")]` declare, do for one release what the new ones do.
"""

from __future__ import annotations

import contextlib
import heapq
from collections.abc import Iterable, Mapping
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from typing import Any

from exmesh_graph.graph.declare.node import NodeDef
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.declare.ports import Port, Signature, signature
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled
from exmesh_graph.graph.language.links import Link
from exmesh_graph.graph.problems import Problem, Problems, Where, nearest

_HINTS = 50  # problems that get hints


class Wiring:
    """The ends that wires may have: definition and signature of every node whose type is known.

    `notes` tell of old names that the graph uses.
    """

    def __init__(self, graph: Unrolled, packs: Packs, problems: Problems) -> None:
        self.graph, self.packs, self.problems = graph, packs, problems
        self.notes: dict[str, None] = {}
        self.definitions: dict[str, NodeDef] = {}
        self.signatures: dict[str, Signature] = {}
        for spec in graph.nodes.values():
            self._find_type(spec)

    def note(self, where: Where, what: str, old: str, new: str) -> str:
        """The present name of something that is written in one it had before."""
        if old != new:
            self.notes[f"{where}: {what} {old!r} is now called {new!r}; the old name goes with the next release"] = None
        return new

    def _find_type(self, spec: NodeSpec) -> None:
        definition = self.packs.find(spec.type)
        if definition is None:
            self.problems.add(
                "node-type", spec.where, f"{spec.name}: there is no node type {spec.type!r}",
                nearest=nearest(spec.type, self.packs.types), fix="exmesh nodes lists all types",
            )  # fmt: skip
            for module, why in self.packs.broken.items():
                what = f"the node module {module} cannot be imported: {why}"
                self.problems.noted["node-module", module] = Problem("node-module", spec.where, what)
            return
        name = self.note(spec.where, "the node type", spec.type, definition.type)
        try:
            self.signatures[spec.name], self.definitions[spec.name] = signature(definition), definition
        except (TypeError, NameError) as error:
            self.problems.add("declaration", spec.where, f"{name} is declared wrongly: {error}")
        if "<locals>" in definition.function.__qualname__ and definition.function.__module__ != "__main__":
            what = f"{name}: {definition.origin} is made inside a function, so that no key can tell its code"
            self.problems.add("declaration", spec.where, what, fix="define it at the top level of a module")

    def connect(
        self, link: Link, where: Where, end: str, port: Port | None = None, user: str = ""
    ) -> tuple[Link, Port] | None:
        """A link in its present name, and the output that it leads to (for a component: a port of its class).

        `end` is the near end, `port` what it takes (None: any artifact), `user` the node that it feeds. What does not
        fit is noted; None where the far end does not exist.
        """

        def refuse(code: str, what: str, **more: Any) -> None:
            far = self.graph.nodes.get(link.node)
            wire = f"{str(link)[1:]} ({far.where if far else 'nowhere'}) -> {end} ({where})"
            self.problems.add(code, where, what, **{"wire": wire, "expected": str(port or ""), **more})

        if link.node not in self.graph.nodes:
            names = [str(replace(link, node=near)) for near in nearest(link.node, self.hinted())]
            what = f"{link}: there is no node {link.node!r}"
            refuse("unknown-node", what, nearest=names or self.suitable(port, user))
            return None
        if link.node not in self.signatures:
            return None
        kind = self.signatures[link.node]
        type, names = self.definitions[link.node].type, [f"@{link.node}.{output}" for output in kind.outputs]
        if kind.component is not None and link.port:
            what, own = f"{link}: {link.node} is a component ({type}), which has no outputs", f"@{link.node}"
            refuse("link", what, nearest=[own], fix=f'link the component itself: "{own}"')
            return None
        if kind.component is None and not link.port:
            fits = [f"@{link.node}.{n}" for n, out in kind.outputs.items() if port is None or port.takes(out)]
            what = f"{link}: {link.node} is a node ({type}); a link names one of its outputs"
            refuse("link", what, nearest=fits or self.suitable(port, user) or names)
            return None
        new = self.note(where, f"the output of {type}", link.port, kind.renamed_outputs.get(link.port, link.port))
        link = replace(link, port=new)
        if kind.component is None and new not in kind.outputs:
            near = [f"@{link.node}.{near}" for near in nearest(new, kind.outputs)] or names
            expected = ", ".join(f"{key}: {out}" for key, out in kind.outputs.items())
            refuse("unknown-port", f"{link}: {type} has no output {new!r}", expected=expected, nearest=near)
            return None
        source = kind.outputs[new] if kind.component is None else Port("", (kind.component,))
        if self.graph.nodes[link.node].each is not None:  # a list of what its nodes make
            source = replace(source, many=True)
        if port is not None and not issubclass(source.type, port.types):
            what, name = f"{link} does not fit {end}", source.type.__name__
            if source.plugged != port.plugged and not port.mixed:
                words = ("an artifact", "a component") if port.plugged else ("a component", "an artifact")
                what = f"{link} is {words[0]}, but {end} takes {words[1]}"
            again = name in [kind.__name__ for kind in port.types]
            fix = f"{name} was defined again: also run again what declares the two nodes" if again else ""
            refuse("wrong-type", what, found=str(source), nearest=self.suitable(port, user), fix=fix)
        elif port is not None:
            for facet, (wanted, promised) in port.clashes(source).items():
                what = f"{link} has {facet}={promised!r}, but {end} takes {facet}={wanted!r}"
                found, near = f"{source}, {facet}={promised!r}", self.suitable(port, user)
                refuse("facet", what, found=found, nearest=near)
        return link, source

    def suitable(self, port: Port | None, user: str) -> list[str]:
        """Links that would fit a port: those known to have its facets first, then those of the user's own block."""
        fits: dict[str, tuple[bool, bool]] = {}
        prefix = user.rpartition(".")[0]
        if port is None:
            return []
        for name, kind in self.signatures.items() if self.hinted() else ():
            far = not name.startswith(prefix)
            if name != user and kind.component is not None and issubclass(kind.component, port.types):
                fits[f"@{name}"] = (False, far)
            for output in kind.outputs.values() if name != user else ():
                if port.takes(output):
                    fits[f"@{name}.{output.name}"] = (not port.facets.keys() <= output.promises.keys(), far)
        return sorted(fits, key=fits.__getitem__)[:3]

    def hinted(self) -> Iterable[str]:
        """The nodes that hints are taken from; none once there are many problems: each hint looks at all nodes."""
        return self.graph.nodes if len(self.problems.noted) < _HINTS else ()

    def order(self, sources: Mapping[str, set[str]]) -> list[str]:
        """Topological order of the nodes in `sources`, ties by the order of the file; what is in and behind a cycle,
        which is noted, is left out.
        """
        names = list(sources)
        rank = {name: index for index, name in enumerate(names)}
        sorter = TopologicalSorter(sources)
        with contextlib.suppress(CycleError):  # what stands neither in a cycle nor behind one still comes out
            sorter.prepare()
        order: list[str] = []
        ready = [rank[name] for name in sorter.get_ready()]
        heapq.heapify(ready)
        while ready:
            order.append(names[heapq.heappop(ready)])
            sorter.done(order[-1])
            for name in sorter.get_ready():
                heapq.heappush(ready, rank[name])
        if len(order) < len(names):
            self._report_cycles(sources, rank)
        return order

    def _report_cycles(self, sources: Mapping[str, set[str]], rank: Mapping[str, int]) -> None:
        """One cycle out of each knot of nodes that all wait for one another."""
        import networkx as nx  # takes 0.2 s to import: only where there is something to tell

        graph = nx.DiGraph([(name, source) for name in sources for source in sorted(sources[name])])
        for knot in nx.strongly_connected_components(graph):
            first = min(knot, key=rank.__getitem__)
            if len(knot) > 1 or first in sources[first]:
                cycle = [name for name, _ in nx.find_cycle(graph.subgraph(knot), first)]
                cycle.append(cycle[0])
                places = {name: self.graph.nodes[name].where for name in cycle}
                self.problems.add(
                    "cycle", places[cycle[0]], f"the nodes wait for each other: {' <- '.join(cycle)}",
                    wire=" <- ".join(f"{name} ({places[name]})" for name in cycle),
                    fix="take one of these links away; what goes round is the carry of a repeat block",
                )  # fmt: skip
