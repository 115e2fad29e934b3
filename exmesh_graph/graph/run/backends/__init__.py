"""Where jobs run. A backend places jobs and reports how they end; data moves through the store, never through it.
The backend of this process stands here beside what all of them are.

The run calls a backend from one thread: `submit` while tokens are free, then `poll` until outcomes come, `close` in
the end. Which node runs when, on how many tokens and under which lease is the run's affair (see `run`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Protocol

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import STOPPED, Emit, Job, Outcome
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.resources import machine_tokens


class Backend(Protocol):
    """What a run asks of a backend."""

    def capacity(self) -> Mapping[str, float]:
        """Tokens that jobs may hold at once: cpu, gpu, vram_gb, ram_gb, any name, and `jobs`, one for each job."""

    def largest(self) -> Mapping[str, float]:
        """What one job can have at most, where `capacity` is that of several machines; empty for a single one."""
        return {}

    def submit(self, job: Job) -> None:
        """Begin a job. Its name is unique among those that run."""

    def grant(self, name: str, cores: int) -> None:
        """Let a running job use so many cores from now on (0: all); nothing where no job runs beside another."""
        return

    def poll(self, timeout: float, emit: Emit) -> list[Outcome]:
        """Wait up to `timeout` seconds for something to happen; events go to `emit`, ended jobs are returned.

        A job whose process died is an outcome as well (failed, with the signal in words and its last output).
        """

    def forget(self, digests: Iterable[str]) -> None:
        """No job to come reads these artifacts: they need not be kept in memory. (Else the least used go first.)"""
        return

    def stop(self) -> None:
        """Ask all running jobs to write a checkpoint where they can and end; they become `stopped` outcomes."""

    def cancel(self, name: str) -> None:
        """End one job at once, whatever it is doing. It gives no outcome."""

    def close(self) -> None:
        """End everything that still runs and let go of the machines."""


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
