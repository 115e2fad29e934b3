"""Judging the wires of an expanded graph: does the far end exist, is its type taken, do the facets agree; cycles.

Facets that an output does not promise are left to the run (see `contracts`).
"""

from __future__ import annotations

import contextlib
import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from exmesh_graph.graph.declare.ports import Port, Signature, link_form
from exmesh_graph.graph.language.expand import NodeSpec, Unrolled
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.problems import Problems, Where, nearest


@dataclass
class Wiring:
    """The wires judged so far: by node and input port, the link and where it was written."""

    graph: Unrolled
    signatures: Mapping[str, Signature]
    problems: Problems
    wires: dict[str, dict[str, tuple[Link, Where]]] = field(default_factory=dict)

    def connect(self, spec: NodeSpec, port: Port, value: Value) -> Link | None:
        """The link of an input port, judged; None where there is none that can be used."""
        link = value.value
        if isinstance(link, Broken) or (link is None and port.optional):
            return None
        if not isinstance(link, Link):
            self.problems.add(
                "link", value.where, f"{spec.name}: {port.name} is an input port, not a parameter",
                expected=f"a link {link_form(port)} that carries {port}",
                found="nothing" if link is None else repr(link), nearest=self.suitable(port, spec.name),
            )  # fmt: skip
            return None
        source = self.source(link, value.where, f"{spec.name}.{port.name}", port, spec.name)
        if source is None:
            return None
        self.wires.setdefault(spec.name, {})[port.name] = (link, value.where)
        self.judge(link, source, port, f"{spec.name}.{port.name}", value.where, spec.name)
        return link

    def source(self, link: Link, where: Where, name: str, port: Port | None = None, user: str = "") -> Port | None:
        """The output that a link points to (for a component: a port of its class); None after a problem was noted.

        `name` is the near end, `port` what it takes (None: any artifact).
        """
        if link.node not in self.graph.nodes:
            port_part = f".{link.port}" if link.port else ""
            names = [f"@{near}{port_part}" for near in nearest(link.node, self.graph.nodes)]
            self.problems.add(
                "unknown-node", where, f"{link}: there is no node {link.node!r}",
                wire=f"{str(link)[1:]} (nowhere) -> {name} ({where})", nearest=names or self.suitable(port, user),
            )  # fmt: skip
            return None
        kind = self.signatures.get(link.node)
        if kind is None:
            return None
        spec, names = self.graph.nodes[link.node], [f"@{link.node}.{output}" for output in kind.outputs]
        if kind.component is not None:
            if link.port:
                self.problems.add(
                    "link", where, f"{link}: {link.node} is a component ({spec.type}), which has no outputs",
                    wire=self._wire(link, name, where), nearest=[f"@{link.node}"],
                    fix=f'link the component itself: "@{link.node}"',
                )  # fmt: skip
                return None
            return Port("", (kind.component,))
        if not link.port:
            fits = [n for n, out in kind.outputs.items() if port is None or port.takes(out)]
            self.problems.add(
                "link", where, f"{link}: {link.node} is a node ({spec.type}); a link names one of its outputs",
                wire=self._wire(link, name, where), expected="" if port is None else str(port),
                nearest=[f"@{link.node}.{near}" for near in fits] or self.suitable(port, user) or names,
            )  # fmt: skip
            return None
        if link.port not in kind.outputs:
            self.problems.add(
                "unknown-port", where, f"{link}: {spec.type} has no output {link.port!r}",
                wire=self._wire(link, name, where),
                expected=", ".join(f"{key}: {out}" for key, out in kind.outputs.items()),
                nearest=[f"@{link.node}.{near}" for near in nearest(link.port, kind.outputs)] or names,
            )  # fmt: skip
            return None
        return kind.outputs[link.port]

    def judge(self, link: Link, source: Port, port: Port, name: str, where: Where, user: str) -> None:
        """Types, presence and facets of one wire; `name` is its near end, `user` the node that it feeds."""
        if not issubclass(source.type, port.types):
            if source.plugged != port.plugged and not port.mixed:
                words = ("an artifact", "a component") if port.plugged else ("a component", "an artifact")
                what = f"{link} is {words[0]}, but {name} takes {words[1]}"
            else:
                what = f"{link} does not fit {name}"
            again = source.type.__name__ in [kind.__name__ for kind in port.types]
            fix = (
                f"{source.type.__name__} was defined again: also run again what declares the two nodes" if again else ""
            )
            self.problems.add(
                "wrong-type", where, what, wire=self._wire(link, name, where), expected=str(port), found=str(source),
                nearest=self.suitable(port, user), fix=fix,
            )  # fmt: skip
        elif source.optional and not port.optional:
            self.problems.add(
                "maybe-absent", where, f"{link} may be absent, but {name} needs it",
                wire=self._wire(link, name, where), expected=str(port), found=f"{source} or nothing",
            )  # fmt: skip
        else:
            for facet, (wanted, promised) in port.clashes(source).items():
                self.problems.add(
                    "facet", where, f"{link} has {facet}={promised!r}, but {name} takes {facet}={wanted!r}",
                    wire=self._wire(link, name, where), expected=str(port), found=f"{source}, {facet}={promised!r}",
                    nearest=self.suitable(port, user),
                )  # fmt: skip

    def _wire(self, link: Link, name: str, where: Where) -> str:
        """Both ends of a wire, for messages."""
        return f"{str(link)[1:]} ({self.graph.nodes[link.node].where}) -> {name} ({where})"

    def suitable(self, port: Port | None, user: str) -> list[str]:
        """Links that would fit a port: those known to have its facets first, then those of the user's own block."""
        fits: dict[str, tuple[bool, bool]] = {}
        prefix = user.rpartition(".")[0]
        if port is None:
            return []
        for name, kind in self.signatures.items():
            far = not name.startswith(prefix)
            if name != user and kind.component is not None and issubclass(kind.component, port.types):
                fits[f"@{name}"] = (False, far)
            for output in kind.outputs.values() if name != user else ():
                if port.takes(output):
                    fits[f"@{name}.{output.name}"] = (not port.facets.keys() <= output.promises.keys(), far)
        return sorted(fits, key=fits.__getitem__)[:3]

    def order(self) -> list[str]:
        """Topological order, ties by the order of the file; nodes in and behind a cycle are left out."""
        names = list(self.graph.nodes)
        rank = {name: index for index, name in enumerate(names)}
        sources = {name: {link.node for link, _ in self.wires.get(name, {}).values()} for name in names}
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
