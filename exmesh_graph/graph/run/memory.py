"""Artifacts that a process keeps between jobs."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from exmesh_graph.types import Artifact
from exmesh_graph.types.contents import arrays_of, mark_of


class Memory:
    """Artifacts by digest, the least recently used dropped beyond `budget` bytes (of their arrays; None: no limit).

    Each has a mark of its bytes: what was changed in place since it was put in, by whichever means, is not given out.
    """

    def __init__(self, budget: int | None = None) -> None:
        self.budget = budget
        self.values: OrderedDict[str, tuple[Artifact, int, int]] = OrderedDict()
        self.bytes = 0

    def get(self, digest: str) -> tuple[Artifact, int] | None:
        """A value and its mark."""
        if digest not in self.values:
            return None
        value, mark, _ = self.values[digest]
        if mark_of(value) != mark:
            self.forget(digest)
            return None
        self.values.move_to_end(digest)
        return value, mark

    def put(self, digest: str, value: Artifact) -> int:
        """Keep a value; its arrays become read-only, since others will read them. Returns its mark."""
        self.forget(digest)
        size, mark = sum(int(array.nbytes) for array in arrays_of(value)), mark_of(value)
        self.values[digest] = frozen(value), mark, size
        self.bytes += size
        while self.budget is not None and self.bytes > self.budget:
            self.forget(next(iter(self.values)))
        return mark

    def forget(self, digest: str) -> None:
        if digest in self.values:
            self.bytes -= self.values.pop(digest)[2]


def frozen(value: Any) -> Any:
    """Make the arrays of a dataclass read-only, so that no node changes what another will read."""
    for array in arrays_of(value):
        array.flags.writeable = False
    return value
