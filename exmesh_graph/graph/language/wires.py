"""Judging the wires of an expanded graph: does the far end exist, is its type taken, do the facets agree; cycles.

Facets that an output does not promise are left to the run (see `contracts`).
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field

from exmesh_graph.graph.declare.ports import Port, Signature, link_form
from exmesh_graph.graph.language.expand import Graph, NodeSpec
from exmesh_graph.graph.language.links import Broken, Link
from exmesh_graph.graph.language.spec import Value
from exmesh_graph.graph.problems import Problems, Where, nearest


@dataclass
class Wiring:
    """The wires found so far: by node and input port, the link and where it was written."""

    graph: Graph
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
            names = [
                f"@{near}.{link.port}" if link.port else f"@{near}" for near in nearest(link.node, self.graph.nodes)
            ]
            self.problems.add(
                "unknown-node", where, f"{link}: there is no node {link.node!r}",
                wire=f"{str(link)[1:]} (nowhere) -> {name} ({where})", nearest=names or self.suitable(port, user),
            )  # fmt: skip
            return None
        found = self.signatures.get(link.node)
        if found is None:
            return None
        spec, names = self.graph.nodes[link.node], [f"@{link.node}.{output}" for output in found.outputs]
        if found.component is not None:
            if link.port:
                self.problems.add(
                    "link", where, f"{link}: {link.node} is a component ({spec.type}), which has no outputs",
                    wire=self._wire(link, name, where), nearest=[f"@{link.node}"],
                    fix=f'link the component itself: "@{link.node}"',
                )  # fmt: skip
                return None
            return Port("", (found.component,))
        if not link.port:
            fits = [n for n, out in found.outputs.items() if port is None or port.takes(out)]
            self.problems.add(
                "link", where, f"{link}: {link.node} is a node ({spec.type}); a link names one of its outputs",
                wire=self._wire(link, name, where), expected="" if port is None else str(port),
                nearest=[f"@{link.node}.{near}" for near in fits] or self.suitable(port, user) or names,
            )  # fmt: skip
            return None
        if link.port not in found.outputs:
            self.problems.add(
                "unknown-port", where, f"{link}: {spec.type} has no output {link.port!r}",
                wire=self._wire(link, name, where),
                expected=", ".join(f"{key}: {out}" for key, out in found.outputs.items()),
                nearest=[f"@{link.node}.{near}" for near in nearest(link.port, found.outputs)] or names,
            )  # fmt: skip
            return None
        return found.outputs[link.port]

    def judge(self, link: Link, source: Port, port: Port, name: str, where: Where, user: str) -> None:
        """Types, presence and facets of one wire; `name` is its near end, `user` the node that it feeds."""
        if not issubclass(source.type, port.types):
            if source.plugged != port.plugged and not port.mixed:
                words = ("an artifact", "a component") if port.plugged else ("a component", "an artifact")
                what = f"{link} is {words[0]}, but {name} takes {words[1]}"
            else:
                what = f"{link} does not fit {name}"
            near = self.suitable(port, user)
            self.problems.add(
                "wrong-type",
                where,
                what,
                wire=self._wire(link, name, where),
                expected=str(port),
                found=str(source),
                nearest=near,
            )
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
        for name, found in self.signatures.items():
            far = not name.startswith(prefix)
            if name != user and found.component is not None and issubclass(found.component, port.types):
                fits[f"@{name}"] = (False, far)
            for output in found.outputs.values() if name != user else ():
                if port.takes(output):
                    fits[f"@{name}.{output.name}"] = (not port.facets.keys() <= output.promises.keys(), far)
        return sorted(fits, key=fits.__getitem__)[:3]

    def order(self) -> list[str]:
        """Topological order (Kahn), ties by the order of the file; nodes in and behind a cycle are left out."""
        rank = {name: index for index, name in enumerate(self.graph.nodes)}
        waits = {name: {link.node for link, _ in self.wires.get(name, {}).values()} for name in rank}
        users: dict[str, list[str]] = {name: [] for name in rank}
        for name, sources in waits.items():
            for source in sources:
                users[source].append(name)
        ready = [rank[name] for name, sources in waits.items() if not sources]
        heapq.heapify(ready)
        names, order = list(rank), []
        while ready:
            name = names[heapq.heappop(ready)]
            order.append(name)
            for user in users[name]:
                waits[user].discard(name)
                if not waits[user]:
                    heapq.heappush(ready, rank[user])
        if len(order) < len(rank):
            done = set(order)
            seen: set[str] = set()
            for name in rank:
                if name not in done and name not in seen:
                    self._report_cycle(name, waits, seen)
        return order

    def _report_cycle(self, start: str, waits: Mapping[str, set[str]], seen: set[str]) -> None:
        """Walk up from `start` until a name comes again; nothing to say where an earlier walk, in `seen`, was there."""
        path = [start]
        while path[-1] not in seen:
            seen.add(path[-1])
            path.append(min(waits[path[-1]]))
        if path[-1] not in path[:-1]:
            return
        cycle = path[path.index(path[-1]) :]
        places = {name: self.graph.nodes[name].where for name in cycle}
        self.problems.add(
            "cycle", places[cycle[0]], f"the nodes wait for each other: {' <- '.join(cycle)}",
            wire=" <- ".join(f"{name} ({places[name]})" for name in cycle),
            fix="take one of these links away; what goes round is the carry of a repeat block",
        )  # fmt: skip
