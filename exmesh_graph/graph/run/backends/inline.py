"""Jobs in this process, one at a time: `poll` runs what was submitted. Nothing to start, and nothing to protect."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import STOPPED, Emit, Job, Outcome
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.graph.run.schedule import machine_tokens


class Inline(Backend):
    """The backend of this process. Neighbours hand values over in memory."""

    def __init__(self, store: Store) -> None:
        self.store, self.memory = store, Memory()
        self.waiting: list[Job] = []
        self.stopped = False

    def capacity(self) -> Mapping[str, float]:
        return {**machine_tokens(), "jobs": 1}

    def submit(self, job: Job) -> None:
        self.waiting.append(job)

    def poll(self, timeout: float, emit: Emit) -> list[Outcome]:
        if self.stopped:
            done = [Outcome(job.name, STOPPED) for job in self.waiting]
        elif self.waiting:
            done = [execute(self.waiting[0], self.store, self.memory, emit)]
        else:
            time.sleep(timeout)  # something else than a job is waited for
            done = []
        self.waiting = self.waiting[1:] if not self.stopped else []
        return done

    def forget(self, digests: Iterable[str]) -> None:
        for digest in digests:
            self.memory.forget(digest)

    def stop(self) -> None:
        self.stopped = True  # nothing runs between two polls

    def cancel(self, name: str) -> None:
        self.waiting = [job for job in self.waiting if job.name != name]

    def close(self) -> None:
        self.waiting.clear()
