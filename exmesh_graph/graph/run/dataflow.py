"""The values of a run: which are known, who still reads them, and which nodes have all that they need."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Mapping

from exmesh_graph.graph.cache.store import Stored
from exmesh_graph.graph.language.check import Bound


class Dataflow:
    """`outputs` holds what is known of each node; `rank` is a node's place in the graph's order."""

    def __init__(self, nodes: Mapping[str, Bound]) -> None:
        self.nodes, self.names = nodes, list(nodes)
        self.rank = {name: index for index, name in enumerate(nodes)}
        self.sources = {name: {link.node for link in bound.inputs.values()} for name, bound in nodes.items()}
        self.users: dict[str, list[str]] = {name: [] for name in nodes}
        self.outputs: dict[str, Mapping[str, Stored]] = {}
        self.readers: Counter[tuple[str, str]] = Counter()  # nodes to come that read an output, by node and port
        self.needed: Counter[str] = Counter()  # the same by digest, of outputs that are known
        for name, bound in nodes.items():
            self._count(bound)
            for source in self.sources[name]:
                self.users[source].append(name)
        self.ready = [index for name, index in self.rank.items() if not self.sources[name]]

    def next(self) -> str | None:
        """A node that may have all that it needs, the first of the graph first."""
        return self.names[heapq.heappop(self.ready)] if self.ready else None

    def waits(self, name: str) -> bool:
        """Whether an input of a node is not known."""
        return not self.sources[name] <= self.outputs.keys()

    def look_again(self, name: str) -> None:
        """Offer a node to `next` if it has all that it needs."""
        if not self.waits(name):
            heapq.heappush(self.ready, self.rank[name])

    def inputs(self, name: str) -> dict[str, Stored]:
        """The inputs of a node that are known, by port."""
        links = self.nodes[name].inputs.items()
        return {port: self.outputs[link.node][link.port] for port, link in links if link.node in self.outputs}

    def settle(self, name: str, outputs: Mapping[str, Stored]) -> list[str]:
        """Note a node's outputs and offer the nodes below; returns the digests that no node to come reads."""
        self.outputs[name] = outputs
        for port, stored in outputs.items():
            self.needed[stored.digest] += self.readers[name, port]
        self.readers.subtract((link.node, link.port) for link in self.nodes[name].inputs.values())
        read = [stored.digest for stored in self.inputs(name).values()]  # without those that are being made again
        self.needed.subtract(read)
        for user in self.users[name]:
            self.look_again(user)
        own = [stored.digest for stored in outputs.values()]
        return [digest for digest in (*own, *read) if self.needed[digest] <= 0]

    def lose(self, name: str) -> None:
        """The outputs of a node are no longer known: it will run again."""
        for stored in self.outputs.pop(name).values():
            self.needed.pop(stored.digest, None)
        self._count(self.nodes[name])
        for other in (name, *self.users[name]):
            self.look_again(other)

    def _count(self, bound: Bound) -> None:
        self.readers.update((link.node, link.port) for link in bound.inputs.values())
