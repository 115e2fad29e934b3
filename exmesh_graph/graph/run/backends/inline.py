"""Jobs in this process, one at a time: `poll` runs what was submitted. Nothing to start, and nothing to protect."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Mapping

from exmesh_graph.errors import ExmeshError
from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.ports import artifact_types
from exmesh_graph.graph.run.backends import Backend
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import STOPPED, Emit, Job, Outcome
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.graph.run.schedule import machine_tokens


class Inline:
    """The backend of this process. Neighbours hand values over in memory."""

    def __init__(self, store: Store) -> None:
        self.store, self.memory = store, Memory()
        self.waiting: list[Job] = []
        self.stopped = False

    def capacity(self) -> Mapping[str, float]:
        return {**machine_tokens(), "jobs": 1}

    def largest(self) -> Mapping[str, float]:
        return {}

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


class BesideMain:
    """Another backend, and this process for jobs whose code or inputs are of `__main__`: a script, a notebook."""

    def __init__(self, backend: Backend, store: Store) -> None:
        self.backend, self.here = backend, Inline(store)

    def capacity(self) -> Mapping[str, float]:
        return self.backend.capacity()

    def largest(self) -> Mapping[str, float]:
        return self.backend.largest()

    def submit(self, job: Job) -> None:
        (self.here if _is_of_main(job) else self.backend).submit(job)

    def poll(self, timeout: float, emit: Emit) -> list[Outcome]:
        if not self.here.waiting:
            return self.backend.poll(timeout, emit)
        why = "runs in the calling process: what a script or a notebook defines cannot go to another one"
        if not self.here.stopped:
            emit({"event": "log", "node": self.here.waiting[0].name, "message": why})
        done = self.backend.poll(0.0, emit)
        return [*done, *self.here.poll(0.0, emit)]

    def forget(self, digests: Iterable[str]) -> None:
        gone = list(digests)
        self.here.forget(gone)
        self.backend.forget(gone)

    def stop(self) -> None:
        self.here.stop()
        self.backend.stop()

    def cancel(self, name: str) -> None:
        self.here.cancel(name)
        self.backend.cancel(name)

    def close(self) -> None:
        self.here.close()
        self.backend.close()


def _is_of_main(job: Job) -> bool:
    homes: list[str] = []
    with contextlib.suppress(ExmeshError):  # told of where it runs
        kinds = artifact_types()
        homes += [definition.function.__module__ for definition in job.bound().definitions()]
        homes += [kinds[name].__module__ for name, _ in job.inputs.values() if name in kinds]
    return "__main__" in homes
