"""Which node can go, which goes first, what may run at once, and who computes what."""

from __future__ import annotations

import heapq
import math
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from exmesh_graph.errors import GraphError
from exmesh_graph.graph.cache.lease import BEAT, Holder, Lease, Leases
from exmesh_graph.graph.cache.store import Stored
from exmesh_graph.graph.declare.node import wanted_of
from exmesh_graph.graph.declare.ports import base_name
from exmesh_graph.graph.language.check import Bound
from exmesh_graph.graph.run.lists import fed
from exmesh_graph.resources import gpu_memory

Tokens = Mapping[str, float]
_ROUNDING = 1e-9
_FEWEST = 4  # cores with which a node that takes any number begins beside others: it has parts that use one
_UNKNOWN_PEAK, _MEMORY_SHARE = 4.0, 0.8


class Pool:
    """Tokens in use and free. `cpu: 0` asks for every cpu of a machine; a request for cpus is cut to what one has.

    On a single machine (no `largest`) a node with `cpu: 0` holds a few cores and may use what nobody holds beside these
    (`cores`): others start beside it, and it makes do with fewer. peaks: bytes of memory of nodes in earlier runs.
    """

    def __init__(self, capacity: Tokens, largest: Tokens | None = None, peaks: Tokens | None = None) -> None:
        self.divided, self.peaks = not largest, peaks or {}
        self.any_number: set[str] = set()
        self.capacity = dict(capacity)
        largest = largest or {}
        self.most = {name: min(count, largest.get(name, count)) for name, count in capacity.items()}  # of one job
        self.free = dict(capacity)
        self.held: dict[str, dict[str, float]] = {}
        self.shares = [1.0] * int(self.capacity.get("gpu", 0))  # free part of each GPU
        self.lent: dict[str, dict[int, float]] = {}

    def wanted(self, bound: Bound) -> dict[str, float]:
        """What a node asks for, one `jobs` token and by default one cpu. Raises GraphError if it can never get it."""
        if {"vram_gb", "vram_gb?"} & set(bound.definition.resources) and "vram_gb" not in self.capacity:
            self.capacity["vram_gb"] = self.free["vram_gb"] = self.most["vram_gb"] = gpu_memory()
        wanted = {"jobs": 1.0, **wanted_of(bound.definition, self.most)}
        if self.divided and bound.definition.resources.get("cpu") == 0:
            self.any_number.add(bound.name)
            wanted["cpu"] = min(wanted["cpu"], max(1.0, min(_FEWEST, wanted["cpu"] // 2)))
        lacking = {name: count for name, count in wanted.items() if count > self.most.get(name, 0.0)}
        if lacking:
            words = ", ".join(f"{name}={count:g}" for name, count in lacking.items())
            there = ", ".join(f"{name}={self.most.get(name, 0.0):g}" for name in lacking)
            what = f"{bound.definition.type} asks for {words}, and there is {there}"
            fix = f"run it on a machine that has it, or say --tokens {words} if this one does"
            raise GraphError(what, where=str(bound.where), fix=fix)
        return wanted

    def fits(self, wanted: Tokens) -> bool:
        enough = all(count <= self.free.get(name, 0.0) + _ROUNDING for name, count in wanted.items())
        return enough and self._devices(wanted.get("gpu", 0.0)) is not None

    def roomy(self, name: str) -> bool:
        """Whether a node with `cpu: 0` goes into memory beside others such that run, by the peaks of earlier runs.

        A node that never ran counts as 4 GB. (Nodes of one core are small: they start as tokens go.)
        """
        large = {name, *self.held} & self.any_number
        needed = sum(self.peaks.get(one, _UNKNOWN_PEAK * 1e9) for one in large) / 1e9
        return name not in large or len(large) == 1 or needed <= _MEMORY_SHARE * self.capacity.get("ram_gb", math.inf)

    def cores(self) -> dict[str, int]:
        """What running nodes with `cpu: 0` may use now: the cores they hold and their part of the free ones. 0, no
        bound, for the others.
        """
        running = [name for name in self.held if name in self.any_number]
        each, rest = divmod(int(self.free["cpu"] + _ROUNDING), len(running) or 1)
        shares = {name: int(self.held[name]["cpu"]) + each + (k < rest) for k, name in enumerate(running)}
        return dict.fromkeys(self.held, 0) | shares

    def take(self, name: str, wanted: dict[str, float]) -> tuple[int, ...]:
        """Hold tokens for a node; returns the numbers of its GPUs."""
        self.held[name] = wanted
        for token, count in wanted.items():
            self.free[token] -= count
        self.lent[name] = self._devices(wanted.get("gpu", 0.0)) or {}
        for device, share in self.lent[name].items():
            self.shares[device] -= share
        return tuple(self.lent[name])

    def give_back(self, name: str) -> None:
        for token, count in self.held.pop(name, {}).items():
            self.free[token] += count
        for device, share in self.lent.pop(name, {}).items():
            self.shares[device] += share

    def _devices(self, count: float) -> dict[int, float] | None:
        """Whole GPUs, or one that has a part left; None where there is none now."""
        share = min(count, 1.0)
        free = [device for device, left in enumerate(self.shares) if left + _ROUNDING >= share]
        number = math.ceil(count)
        return dict.fromkeys(free[:number], share) if len(free) >= number else None


class KeyLeases:
    """The leases of the keys that this run computes, kept alive by a thread; `elsewhere`: nodes that others compute."""

    def __init__(self, root: Path, say: Callable[[str, str], None]) -> None:
        self.leases, self.say = Leases(root), say
        self.held: dict[str, Lease] = {}
        self.elsewhere: set[str] = set()
        self.notices: set[str] = set()
        self.over = threading.Event()
        self.heart: threading.Thread | None = None
        self.guard = threading.Lock()  # nothing beats through a handle that was closed

    def take(self, name: str, key: str) -> bool:
        """Whether this run may compute a key now; else another process does, and its record will come."""
        lease = self.leases.acquire(key)
        if isinstance(lease, Holder):
            if name not in self.elsewhere and lease.pid:
                self.say(name, f"waits for {lease}, which computes the same")
            self.elsewhere.add(name)
            return False
        self.elsewhere.discard(name)
        with self.guard:
            self.held[name] = lease
        if lease.notice and lease.notice not in self.notices:
            self.notices.add(lease.notice)
            self.say(name, lease.notice)
        if self.heart is None:
            self.heart = threading.Thread(target=self._beat, daemon=True)
            self.heart.start()
        return True

    def give_back(self, name: str) -> None:
        with self.guard:
            self.held.pop(name).release()

    def close(self) -> None:
        self.over.set()
        for name in list(self.held):
            self.give_back(name)

    def _beat(self) -> None:
        while not self.over.wait(BEAT):
            with self.guard:
                for lease in self.held.values():
                    lease.beat()


def remaining_seconds(nodes: Mapping[str, Bound], past: Mapping[str, float]) -> dict[str, float]:
    """The longest path from the start of each node to the end of the graph, in seconds.

    A node that never ran counts as the mean of its type, a type that never ran as one second.
    """
    of_type: dict[str, list[float]] = {}
    for name, bound in nodes.items():
        if name in past:
            of_type.setdefault(bound.definition.type, []).append(past[name])
    means = {kind: sum(values) / len(values) for kind, values in of_type.items()}
    after: dict[str, float] = {}
    for name in reversed(list(nodes)):
        bound = nodes[name]
        total = after.get(name, 0.0) + past.get(name, means.get(bound.definition.type, 1.0))
        after[name] = total
        for link in bound.inputs.values():
            after[link.node] = max(after.get(link.node, 0.0), total)
    return after


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
        return {port: stored for port, (_, stored) in fed(self.nodes[name], self.outputs).items()}

    def settle(self, name: str, outputs: Mapping[str, Stored]) -> list[str]:
        """Note a node's outputs and offer the nodes below; returns the digests that no node to come reads."""
        self.outputs[name] = outputs
        for port, stored in outputs.items():
            self.needed[stored.digest] += sum(self.readers[name, one] for one in {port, base_name(port)})
        self.readers.subtract((link.node, link.port) for link in self.nodes[name].inputs.values())
        read = [stored.digest for stored in self.inputs(name).values()]  # without those that are being made again
        self.needed.subtract(read)
        for user in self.users[name]:
            self.look_again(user)
        own = [stored.digest for stored in outputs.values()]
        return [digest for digest in (*own, *read) if self.needed[digest] <= 0]

    def spread(self, name: str, parts: Sequence[Bound]) -> None:
        """From now on a node waits for `parts`, which are in `nodes`, and no longer for what it is wired to."""
        self.sources[name] = {part.name for part in parts}
        for part in parts:
            self.rank[part.name] = len(self.names)
            self.names.append(part.name)
            self.sources[part.name] = {link.node for link in part.inputs.values()}
            self.users[part.name] = [name]
            for source in self.sources[part.name]:
                self.users[source].append(part.name)
            self._count(part)
            for link in part.inputs.values():  # what is known already has one more reader
                self.needed[self.outputs[link.node][link.port].digest] += 1
            self.look_again(part.name)

    def lose(self, name: str) -> None:
        """The outputs of a node are no longer known: it will run again."""
        for stored in self.outputs.pop(name).values():
            self.needed.pop(stored.digest, None)
        self._count(self.nodes[name])
        for other in (name, *self.users[name]):
            self.look_again(other)

    def _count(self, bound: Bound) -> None:
        self.readers.update((link.node, link.port) for link in bound.inputs.values())
