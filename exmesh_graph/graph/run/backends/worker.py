"""A warm worker process: jobs come as JSON lines on stdin, events and outcomes go out as JSON lines.

It keeps artifacts in memory between jobs and loads a library once. What a node prints, native libraries included,
goes to the job's log file. The pipe to the run is the worker's life line: when it closes, the worker exits.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from exmesh_graph.graph.cache.store import Store
from exmesh_graph.graph.declare.packs import Packs
from exmesh_graph.graph.run.execute import execute
from exmesh_graph.graph.run.job import STOPPED, Job, Outcome
from exmesh_graph.graph.run.memory import Memory
from exmesh_graph.resources import grant_cores

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def main(budget: int) -> None:
    """Work until the pipe closes. `budget` is in bytes of artifacts kept in memory."""
    _Worker(budget).work()


LOG_BYTES = 16 * 2**20  # of a log; what was printed before lies in NAME.log.1, and what before that is gone
_LOOK = 0.3  # seconds


class _Worker:
    def __init__(self, budget: int) -> None:
        self.commands = os.fdopen(os.dup(0), "r", encoding="utf-8")
        self.out = os.dup(1)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(2, 1)
        self.idle_output = os.dup(2)
        self.memory = Memory(budget)
        self.stores: dict[str, Store] = {}
        self.sessions: dict[tuple[str, ...], Packs] = {}
        self.queue: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.busy = False
        self.threads = 0

    def work(self) -> None:
        faulthandler.enable(2, all_threads=False)
        signal.signal(signal.SIGINT, self._interrupt)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])  # a Ray worker starts us blocked
        threading.Thread(target=self._read, daemon=True).start()
        while True:
            command = self.queue.get()
            for digest in command.get("forget", ()):
                self.memory.forget(digest)
            if "job" in command:
                self._send({"outcome": self._run(Job.from_json(command["job"])).to_json()})

    def _run(self, job: Job) -> Outcome:
        store = self.stores.setdefault(job.store, Store(Path(job.store)))
        with _output_to(job.log, self.idle_output):
            try:
                self.busy = True
                self._limit_threads(job.threads)
                with self._session(job.packs):
                    return execute(job, store, self.memory, self._send)
            except KeyboardInterrupt:
                self.busy = False
                self._send({})  # ends a line that was cut off
                return Outcome(job.name, STOPPED)
            finally:
                self.busy = False

    def _limit_threads(self, count: int) -> None:
        """How many threads native libraries may use: one that is loaded from here on reads it from the environment,
        pools that are there are told.
        """
        if count == self.threads:
            return
        self.threads = count
        os.environ.update(dict.fromkeys(_THREAD_VARIABLES, str(count)))
        threadpool_limits(count)
        if (torch := sys.modules.get("torch")) is not None:
            torch.set_num_threads(count)

    def _session(self, names: tuple[str, ...]) -> Packs:
        """That of the run that sent a job: the same packs."""
        if names not in self.sessions:
            self.sessions[names] = Packs(names or None).load()
        return self.sessions[names]

    def _interrupt(self, number: int, frame: Any) -> None:
        if self.busy:
            raise KeyboardInterrupt

    def _read(self) -> None:
        for line in self.commands:
            command = json.loads(line)
            if "cores" in command:  # at once, beside the job that runs
                grant_cores(command["cores"])
            self.queue.put(command)
        os._exit(1)

    def _send(self, message: Mapping[str, Any], dumps: Any = json.dumps, loads: Any = json.loads) -> None:
        # separators are given, so that a node that changed the encoder's does not change the lines
        data = b"\n" + dumps(message, default=str, separators=(",", ":")).encode() + b"\n"
        loads(data)  # where a node spoilt more of it: a worker that ends is better than a run that waits for ever
        try:
            while data:
                data = data[os.write(self.out, data) :]
        except BrokenPipeError:
            os._exit(1)


def _rotate(path: Path, ended: threading.Event) -> None:
    """Keep the log of a running node short, whoever in this process writes it."""
    while not ended.wait(_LOOK):
        with contextlib.suppress(OSError):
            if path.stat().st_size > LOG_BYTES:
                os.replace(path, f"{path}.1")
                file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
                os.write(file, f"(printed before: {path.name}.1)\n".encode())
                for number in (1, 2):
                    os.dup2(file, number)
                os.close(file)


@contextlib.contextmanager
def _output_to(log: str, otherwise: int) -> Iterator[None]:
    """Point the process's output at a file, which goes away again if nothing was written."""
    if not log:
        yield
        return
    path = Path(log)
    path.parent.mkdir(parents=True, exist_ok=True)
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for number in (1, 2):
        os.dup2(file, number)
    ended = threading.Event()
    watch = threading.Thread(target=_rotate, args=(path, ended), daemon=True)
    watch.start()
    try:
        yield
    finally:
        ended.set()
        watch.join()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        for number in (1, 2):
            os.dup2(otherwise, number)
        if os.fstat(file).st_size == 0:
            path.unlink(missing_ok=True)
        os.close(file)
