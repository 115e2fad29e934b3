"""Leases: who computes a key right now, so that two processes in need of one result do not both compute it.

    leases/<key>.json   {host, pid, beats}: locked by its owner while that lives, and removed by it in the end

A lease saves work and guards nothing: two owners of one key would both write the same sound result. The lock (flock, on
NFS too) ends with the process or its machine, however they end, so that a lease without one is free. An owner that
hangs or is stopped keeps its lock: whoever saw `beats` stand still for `limit` seconds of its own monotonic clock goes
on beside it. Wall clocks and file times play no part.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from exmesh_graph import files

LIMIT = 900.0  # seconds; native code may hold up the heartbeat for long
BEAT = 5.0


@dataclass(frozen=True)
class Holder:
    """Who holds a lease; `age` is for how many seconds this process has seen its heartbeat stand still."""

    host: str
    pid: int
    age: float = 0.0

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


@dataclass
class Lease:
    """A held lease. `notice` says whose lease was taken over, or why there is none (`handle` is None); else empty."""

    path: Path
    handle: int | None
    notice: str = ""
    beats: int = 0

    def beat(self) -> None:
        """Say that the work goes on; every BEAT seconds will do."""
        self.beats += 1
        if self.handle is not None:
            text = json.dumps({"host": platform.node(), "pid": os.getpid(), "beats": self.beats})
            with contextlib.suppress(OSError):  # the lock alone will do
                os.ftruncate(self.handle, os.pwrite(self.handle, text.encode(), 0))

    def release(self) -> None:
        """Give the lease back."""
        if self.handle is not None:
            files.unlock(self.path, self.handle)
        self.handle = None


class Leases:
    """The leases of a store. Waiting is asking again: a waiter has to keep its `Leases` for heartbeats to be seen."""

    def __init__(self, root: Path, limit: float = LIMIT, clock: Callable[[], float] = time.monotonic) -> None:
        self.folder, self.limit, self.clock = root / "leases", limit, clock
        self.seen: dict[Path, tuple[str, float]] = {}

    def acquire(self, key: str) -> Lease | Holder:
        """The lease of `key`, or who holds it. Where none can be had, an unguarded lease with a notice."""
        path = self.folder / f"{key}.json"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle = files.lock(path)
        except OSError as error:
            return Lease(path, None, f"no lease can be written ({error.strerror}): others may do the same work")
        before = _told(path)
        if handle is None:
            text, since = self.seen.get(path, ("", 0.0))
            if text != before:
                since = self.clock()
                self.seen[path] = before, since
            age = self.clock() - since
            holder = _holder(before, age)
            if age <= self.limit:
                return holder
            return Lease(path, None, f"the lease of {holder} has had no heartbeat for {age:.0f} s; not waited for")
        lease = Lease(path, handle, f"{_outlived(before)}; taken over" if before else "")
        lease.beat()
        return lease

    def holders(self) -> Iterator[str]:
        """The keys that are leased."""
        return (path.stem for path in sorted(self.folder.glob("*.json")) if files.is_locked(path))

    def sweep(self) -> list[str]:
        """Remove leases that are free; says which."""
        gone = []
        for path in sorted(self.folder.glob("*.json")):
            with contextlib.suppress(OSError):
                handle = files.lock(path, make=False)
                if handle is not None:
                    gone.append(_outlived(_told(path)))
                    files.unlock(path, handle)
        return gone


def _told(path: Path) -> str:
    with contextlib.suppress(OSError):
        return path.read_text(encoding="utf-8", errors="replace")
    return ""


def _holder(text: str, age: float = 0.0) -> Holder:
    """Who wrote a lease, as far as it can be read."""
    with contextlib.suppress(ValueError, KeyError, TypeError):
        told = json.loads(text)
        return Holder(str(told["host"]), int(told["pid"]), age)
    return Holder("unknown", 0, age)


def _outlived(text: str) -> str:
    return f"the lease of {_holder(text)} outlived its process"
